within Daest.Effects.Rotational;
model ViscousFriction "Friction in proportion to the angular velocity"
  extends Interfaces.PartialFriction;
  parameter SI.RotationalDampingConstant d(min = 0) = 0.001 "Damping constant"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  tau = -d*w;
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "tau = -d*w"),
    Documentation(info = "A film of oil or grease resists with a torque in proportion to the angular
velocity."));
end ViscousFriction;
