within Daest.Effects.Rotational;
model CubicSpring "Spring to the housing whose torque goes with the cube of the angle"
  extends Interfaces.PartialFlange;
  parameter Real c3(unit = "N.m/rad3") = 1 "Cubic stiffness"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Angle phi_0 = 0 "Angle from which the cube counts"
    annotation(__Daest(estimate = true, role = "shape", of = "phi", grid = {-0.3, 0, 0.3}));
equation
  tau = -c3*(phi - phi_0)^3;
  annotation(
    __Daest(effect = true, attach = "connector", turns = 30, law = "tau = -c3*(phi - phi_0)^3"),
    Documentation(info = "Beside the linear spring of a shaft it hardens (c3 > 0) or softens (c3 < 0)
the support, on one side more than on the other unless phi_0 = 0. HardeningSpring is the same between two shafts."));
end CubicSpring;
