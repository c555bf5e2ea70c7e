within Daest.Effects.Hydraulic;
model Weir "Liquid that runs over the rim of one vessel into the next"
  extends Daest.Hydraulic.Interfaces.PartialLine;
  parameter Real k(unit = "m3/(s.Pa)", min = 0) = 1e-7 "Flow per pressure above the rim"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real p_max(unit = "Pa", min = 0) = 1e3 "Pressure at port_a when the liquid reaches the rim"
    annotation(__Daest(estimate = true, role = "shape", of = "p", grid = {0.7, 0.8, 0.9, 0.95}));
  parameter Real p_s(unit = "Pa", min = 1e-12) = 1 "Pressure over which the overflow begins"
    annotation(__Daest(role = "sharpness", of = "p", grid = {0.01}));
  Real p(unit = "Pa") "Gauge pressure at port_a (= port_a.p)";
equation
  p = port_a.p;
  q = k*(p - p_max + sqrt((p - p_max)^2 + p_s^2))/2;
  annotation(
    __Daest(effect = true, attach = "parallel", grounded = "Overflow",
      law = "q = k*(p - p_max + sqrt((p - p_max)^2 + p_s^2))/2"),
    Documentation(info = "It lies beside the outlet of a tank, from its bottom, where the pressure tells the
level, to the next vessel. What runs over arrives there; what misses it is an Overflow besides."));
end Weir;
