within Daest.Effects.Hydraulic;
model FreeOutlet "Turbulent flow out of the system, through a hole or a pipe"
  extends Interfaces.PartialPort;
  parameter Real k(unit = "m3/s", min = 0) = 1e-6 "Flow at 1 Pa above the outlet"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real p_0(unit = "Pa") = 0 "Pressure at the port when the liquid is no higher than the end of the outlet"
    annotation(__Daest(estimate = true, role = "shape", of = "p", grid = {0.0, 0.3}));
  parameter Real p_s(unit = "Pa", min = 1e-12) = 1 "Pressure over which the flow begins"
    annotation(__Daest(role = "sharpness", of = "p", grid = {0.01}));
  parameter Real p_1(unit = "Pa") = 1 "Unit of the pressure";
equation
  q = -k*sqrt((p - p_0 + sqrt((p - p_0)^2 + p_s^2))/(2*p_1));
  annotation(
    __Daest(
      effect = true, attach = "connector", law = "q = -k*sqrt((p - p_0 + sqrt((p - p_0)^2 + p_s^2))/(2*p_1))"),
    Documentation(info = "Torricelli's law: a tank that drains through a hole, a valve or a pipe. A pipe that leads
down from the tank ends below it, where p_0 is negative."));
end FreeOutlet;
