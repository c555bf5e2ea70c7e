within Daest.Effects.Hydraulic;
model TurbulentLine "Turbulent flow from one vessel to the next"
  extends Daest.Hydraulic.Interfaces.PartialLine;
  parameter Real k(unit = "m3/s", min = 0) = 1e-6 "Flow at a pressure drop of 1 Pa"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real p_s(unit = "Pa", min = 1e-12) = 1 "Pressure drop over which the flow is laminar"
    annotation(__Daest(role = "sharpness", of = "dp", grid = {0.01}));
  parameter Real p_1(unit = "Pa") = 1 "Unit of the pressure";
equation
  q = k*dp/(p_1*sqrt(dp^2 + p_s^2))^0.5;
  annotation(
    __Daest(effect = true, attach = "parallel", law = "q = k*dp/(p_1*sqrt(dp^2 + p_s^2))^0.5"),
    Documentation(info = "It lies beside a line whose flow goes with the drop: what is left of that tells how laminar
the flow is. An Orifice, in series with a line, drops the pressure in proportion to the square of the flow."));
end TurbulentLine;
