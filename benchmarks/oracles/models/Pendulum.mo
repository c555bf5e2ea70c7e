model Pendulum "Point mass on a rod in Cartesian coordinates, index 3, from rest at the horizontal"
  constant Real g = 9.81;
  Real x(start = 1, fixed = true);
  Real y(start = 0);
  Real vx(start = 0);
  Real vy(start = 0, fixed = true);
  Real lambda;
equation
  der(x) = vx;
  der(y) = vy;
  der(vx) = -lambda*x;
  der(vy) = -lambda*y - g;
  x^2 + y^2 = 1;
end Pendulum;
