within Daest.Effects.Translational;
model CubicSpring "Spring to the housing whose force goes with the cube of the displacement"
  extends Interfaces.PartialFlange;
  parameter Real c3(unit = "N/m3") = 1e6 "Cubic stiffness"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Position s_0 = 0 "Position from which the cube counts"
    annotation(__Daest(estimate = true, role = "shape", of = "s", grid = {-0.3, 0, 0.3}));
equation
  f = -c3*(s - s_0)^3;
  annotation(
    __Daest(effect = true, attach = "connector", law = "f = -c3*(s - s_0)^3"),
    Documentation(info = "Beside the linear spring of a body it hardens (c3 > 0) or softens (c3 < 0)
the support, on one side more than on the other unless s_0 = 0. HardeningSpring is the same between two bodies."));
end CubicSpring;
