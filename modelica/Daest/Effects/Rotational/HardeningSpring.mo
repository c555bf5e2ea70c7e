within Daest.Effects.Rotational;
model HardeningSpring "Spring whose torque goes with the cube of the deflection"
  extends Daest.Mechanics.Rotational.Interfaces.PartialCompliant;
  parameter Real c3(unit = "N.m/rad3") = 1 "Cubic stiffness"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  tau = c3*phi_rel^3;
  annotation(
    __Daest(effect = true, attach = "parallel", outside = "input", law = "tau = c3*phi_rel^3"),
    Documentation(info = "In parallel to a spring it makes it stiffer (c3 > 0) or softer (c3 < 0)
the further it is deflected."));
end HardeningSpring;
