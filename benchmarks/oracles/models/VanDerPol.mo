model VanDerPol "Relaxation oscillator with a time scale of 1e-6 beside one of 1 (Test Set for IVP Solvers 2.4)"
  parameter Real eps = 1e-6;
  Real y1(start = 2, fixed = true);
  Real y2(start = 0, fixed = true);
equation
  der(y1) = y2;
  eps*der(y2) = (1 - y1^2)*y2 - y1;
end VanDerPol;
