model Shaken "A mass on a spring and a damper whose foot is moved"
  parameter Real m(unit = "kg", min = 0) = 1 "Mass";
  parameter Real c(unit = "N/m", min = 0) = 40 "Spring" annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.s/m", min = 0) = 1 "Damper" annotation(__Daest(estimate = true));
  input Real z(unit = "m") "Position of the foot";
  output Real s(unit = "m") "Position of the mass";
  Real v(unit = "m/s") "Speed";
  Real foot(unit = "m") = z;
equation
  der(s) = v;
  m*der(v) = c*(foot - s) + d*(der(foot) - v);
end Shaken;
