within Daest.Effects.Translational;
model HardeningSpring "Spring whose force goes with the cube of the deflection"
  extends Daest.Mechanics.Translational.Interfaces.PartialCompliant;
  parameter Real c3(unit = "N/m3") = 1e6 "Cubic stiffness"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  f = c3*s_rel^3;
  annotation(
    __Daest(effect = true, attach = "parallel", outside = "input", law = "f = c3*s_rel^3"),
    Documentation(info = "In parallel to a spring it makes it stiffer (c3 > 0) or softer (c3 < 0)
the further it is deflected."));
end HardeningSpring;
