model Robertson "Autocatalytic reaction of Robertson, rates apart by nine orders of magnitude (Test Set for IVP Solvers 2.4)"
  Real y1(start = 1, fixed = true, nominal = 1e-6);
  Real y2(start = 0, fixed = true, nominal = 1e-12);
  Real y3(start = 0, fixed = true);
equation
  der(y1) = -0.04*y1 + 1e4*y2*y3;
  der(y2) = 0.04*y1 - 1e4*y2*y3 - 3e7*y2^2;
  der(y3) = 3e7*y2^2;
end Robertson;
