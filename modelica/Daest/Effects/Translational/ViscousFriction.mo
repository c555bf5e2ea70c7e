within Daest.Effects.Translational;
model ViscousFriction "Friction in proportion to the velocity"
  extends Interfaces.PartialFriction;
  parameter SI.TranslationalDampingConstant d(min = 0) = 1 "Damping constant"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  f = -d*v;
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "f = -d*v"),
    Documentation(info = "A film of oil or grease resists with a force in proportion to the velocity."));
end ViscousFriction;
