within Daest.Effects.Hydraulic;
model Overflow "Liquid that runs over the rim of a tank"
  extends Interfaces.PartialPort;
  parameter Real k(unit = "m3/(s.Pa)", min = 0) = 1e-7 "Flow per pressure above the rim"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real p_max(unit = "Pa", min = 0) = 1e3 "Pressure at the port when the liquid reaches the rim"
    annotation(__Daest(estimate = true, role = "shape", of = "p", grid = {0.8, 0.9, 0.95}));
  parameter Real p_s(unit = "Pa", min = 1e-12) = 1 "Pressure over which the overflow begins"
    annotation(__Daest(role = "sharpness", of = "p", grid = {0.01}));
equation
  q = -k*(p - p_max + sqrt((p - p_max)^2 + p_s^2))/2;
  annotation(
    __Daest(effect = true, attach = "connector", law = "q = -k*(p - p_max + sqrt((p - p_max)^2 + p_s^2))/2"),
    Documentation(info = "It is connected to the bottom of the tank, where the pressure tells the
level. What runs over is lost."));
end Overflow;
