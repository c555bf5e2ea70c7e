model Loop "A nonlinear algebraic equation inside a first-order lag"
  parameter Real a = 1 "Rate";
  Real x(start = 0.3, fixed = true);
  Real z(start = 0.3);
  input Real u;
  input Real w annotation(__Daest(noise = true, intensity = 1e-2));
  output Real y = z annotation(__Daest(std = 0.1));
equation
  der(x) = -a*z + u + w;
  z + z^3/3 = x;
end Loop;
