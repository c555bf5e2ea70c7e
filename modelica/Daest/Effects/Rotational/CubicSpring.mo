within Daest.Effects.Rotational;
model CubicSpring "Spring to the housing whose torque goes with the cube of the angle"
  extends Interfaces.PartialFlange;
  parameter Real c3(unit = "N.m/rad3") = 1 "Cubic stiffness"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  tau = -c3*phi^3;
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "tau = -c3*phi^3"),
    Documentation(info = "Beside the linear spring of a shaft it hardens (c3 > 0) or softens (c3 < 0)
the support. HardeningSpring is the same between two shafts."));
end CubicSpring;
