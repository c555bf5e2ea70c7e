within Daest.Effects.Hydraulic;
model Orifice "Pressure drop in proportion to the square of the flow"
  extends Daest.Hydraulic.Interfaces.PartialLine;
  parameter Real k(unit = "Pa.s2/m6", min = 0) = 1e10 "Pressure drop over flow squared"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real q_s(unit = "m3/s", min = 1e-12) = 1e-7 "Flow over which the drop is linear"
    annotation(__Daest(role = "sharpness", of = "q", grid = {0.01}));
equation
  dp = k*q*sqrt(q^2 + q_s^2);
  annotation(
    __Daest(effect = true, attach = "series", law = "dp = k*q*sqrt(q^2 + q_s^2)"),
    Documentation(info = "Turbulent flow through valves, bends and holes."));
end Orifice;
