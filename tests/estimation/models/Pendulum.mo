model Pendulum "Point mass on a rigid massless rod, in Cartesian coordinates: a DAE of index 3"
  parameter Real m(unit = "kg") = 0.5 "Mass";
  parameter Real L(unit = "m") = 1 "Length of the rod";
  parameter Real d(unit = "N.s/m") = 0.05 "Friction against the air";
  constant Real g(unit = "m/s2") = 9.81 "Gravity";
  Real x(unit = "m", start = 0.6, fixed = true) "To the right of the pivot";
  Real y(unit = "m", start = -0.8) "Above the pivot";
  Real vx(unit = "m/s", start = 0, fixed = true) "Velocity";
  Real vy(unit = "m/s") "Velocity";
  Real F(unit = "N/m") "Force in the rod per length";
  input Real u(unit = "N", start = 0) "Horizontal force";
  input Real w(unit = "N") annotation(__Daest(noise = true, intensity = 1e-3));
  output Real right(unit = "m") = x annotation(__Daest(std = 0.02));
  output Real up(unit = "m") = y annotation(__Daest(std = 0.02));
equation
  der(x) = vx;
  der(y) = vy;
  m*der(vx) = -F*x - d*vx + u + w;
  m*der(vy) = -F*y - d*vy - m*g;
  x^2 + y^2 = L^2;
end Pendulum;
