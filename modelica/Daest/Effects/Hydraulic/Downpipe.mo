within Daest.Effects.Hydraulic;
model Downpipe "Turbulent flow down into the next vessel, through a hole or a pipe that ends above its liquid"
  extends Daest.Hydraulic.Interfaces.PartialLine;
  parameter Real k(unit = "m3/s", min = 0) = 1e-6 "Flow at 1 Pa above the outlet"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real p_0(unit = "Pa") = 0 "Pressure at port_a when the liquid is no higher than the end of the outlet"
    annotation(__Daest(estimate = true, role = "shape", of = "p", grid = {0.0, 0.3}));
  parameter Real p_s(unit = "Pa", min = 1e-12) = 1 "Pressure over which the flow begins"
    annotation(__Daest(role = "sharpness", of = "p", grid = {0.01}));
  parameter Real p_1(unit = "Pa") = 1 "Unit of the pressure";
  Real p(unit = "Pa") "Gauge pressure at port_a (= port_a.p)";
equation
  p = port_a.p;
  q = k*sqrt((p - p_0 + sqrt((p - p_0)^2 + p_s^2))/(2*p_1));
  annotation(
    __Daest(effect = true, attach = "parallel", grounded = "FreeOutlet",
      law = "q = k*sqrt((p - p_0 + sqrt((p - p_0)^2 + p_s^2))/(2*p_1))"),
    Documentation(info = "Torricelli's law between the tanks of a cascade: the lower one is open and does not hold the
flow back. Where it does, the flow follows the difference of the levels and is a TurbulentLine; what leaves the
system is a FreeOutlet."));
end Downpipe;
