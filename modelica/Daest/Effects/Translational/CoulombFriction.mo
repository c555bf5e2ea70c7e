within Daest.Effects.Translational;
model CoulombFriction "Dry friction: a force of constant size against the motion"
  extends Interfaces.PartialFriction;
  parameter SI.Force f_c(min = 0) = 1 "Friction force in motion"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Velocity v_s(min = 1e-12) = 0.001 "Velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "v", grid = {0.01}));
equation
  f = -f_c*tanh(v/v_s);
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "f = -f_c*tanh(v/v_s)"),
    Documentation(info = "Bearings, seals, guides and gears rub with a force that hardly depends on
the velocity. It takes energy out of the body in both directions. The step of the ideal law is rounded over
v_s, which is not estimated: about 1 % of the range of the velocity."));
end CoulombFriction;
