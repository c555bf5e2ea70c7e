within Daest.Effects.Translational;
model CubicSpring "Spring to the housing whose force goes with the cube of the displacement"
  extends Interfaces.PartialFlange;
  parameter Real c3(unit = "N/m3") = 1e6 "Cubic stiffness"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  f = -c3*s^3;
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "f = -c3*s^3"),
    Documentation(info = "Beside the linear spring of a body it hardens (c3 > 0) or softens (c3 < 0)
the support. HardeningSpring is the same between two bodies."));
end CubicSpring;
