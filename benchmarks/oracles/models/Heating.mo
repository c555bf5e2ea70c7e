model Heating "A lamp heats a plate: one lag and the surroundings"
  parameter Real k = 15 annotation(__Daest(estimate = true));
  parameter Real T(min = 0) = 100 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real y0 = 30 annotation(__Daest(estimate = true));
  input Real u;
  output Real y annotation(__Daest(std = 1));
  Real x;
equation
  T*der(x) = k*u - x;
  y = y0 + x;
end Heating;
