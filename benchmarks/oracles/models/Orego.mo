model Orego "Belousov-Zhabotinsky reaction, the oregonator (Test Set for IVP Solvers 2.4)"
  parameter Real s = 77.27;
  parameter Real w = 0.161;
  parameter Real q = 8.375e-6;
  Real y1(start = 1, fixed = true);
  Real y2(start = 2, fixed = true);
  Real y3(start = 3, fixed = true);
equation
  der(y1) = s*(y2 - y1*y2 + y1 - q*y1^2);
  der(y2) = (-y2 - y1*y2 + y3)/s;
  der(y3) = w*(y1 - y3);
end Orego;
