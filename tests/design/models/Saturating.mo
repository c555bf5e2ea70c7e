model Saturating "A saturating law behind a fast lag: its D-optimal levels are known in closed form"
  parameter Real V(min = 0) = 1 "Largest value" annotation(__Daest(estimate = true));
  parameter Real K(min = 0) = 0.3 "Level of the half" annotation(__Daest(estimate = true));
  input Real u(start = 0);
  output Real y annotation(__Daest(std = 0.01));
  Real x(start = 0);
equation
  0.002*der(x) = V*u/(K + u) - x;
  y = x;
end Saturating;
