model Walk "A lag that white noise drives besides its input"
  parameter Real a(unit = "1/s", min = 0) = 2 "Rate" annotation(__Daest(estimate = true));
  parameter Real k(unit = "1/s", min = 0) = 3 "Gain" annotation(__Daest(estimate = true));
  input Real u(start = 0) "Drive";
  input Real w "Disturbance" annotation(__Daest(noise = true, intensity = 0.05));
  output Real y "Response" annotation(__Daest(std = 0.1));
  Real x(start = 0, fixed = true);
equation
  der(x) = -a*x + k*u + w;
  y = x;
end Walk;
