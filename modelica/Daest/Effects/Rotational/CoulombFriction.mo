within Daest.Effects.Rotational;
model CoulombFriction "Dry friction: a torque of constant size against the motion"
  extends Interfaces.PartialFriction;
  parameter SI.Torque tau_c(min = 0) = 0.01 "Friction torque in motion"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.AngularVelocity w_s(min = 1e-12) = 0.01 "Angular velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "w", grid = {0.01}));
equation
  tau = -tau_c*tanh(w/w_s);
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "tau = -tau_c*tanh(w/w_s)"),
    Documentation(info = "Bearings, seals, guides and gears rub with a torque that hardly depends on
the angular velocity. It takes energy out of the shaft in both directions. The step of the ideal law is
rounded over w_s, which is not estimated: about 1 % of the range of the angular velocity."));
end CoulombFriction;
