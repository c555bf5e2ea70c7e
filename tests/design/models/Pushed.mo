model Pushed "A mass with viscous friction on a spring, moved by a force"
  parameter Real m(unit = "kg", min = 0) = 1.2 "Mass" annotation(__Daest(estimate = true));
  parameter Real b(unit = "N.s/m", min = 0) = 0.8 "Friction" annotation(__Daest(estimate = true));
  parameter Real c(unit = "N/m", min = 0) = 30 "Spring" annotation(__Daest(estimate = true));
  parameter Real g(unit = "1", min = 0) = 1 "Gain of the drive";
  input Real F(unit = "N", start = 0) "Force";
  output Real y(unit = "m") "Position" annotation(__Daest(std = 0.002));
  Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
  Real f(unit = "N") "Force on the mass";
equation
  der(x) = v;
  m*der(v) = f - b*v - c*x;
  f = g*F;
  y = x;
end Pushed;
