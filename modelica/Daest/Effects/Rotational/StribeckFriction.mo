within Daest.Effects.Rotational;
model StribeckFriction "Dry friction that is larger at low angular velocity"
  extends Interfaces.PartialFriction;
  parameter SI.Torque tau_c(min = 0) = 0.01 "Friction torque at high angular velocity"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real b(unit = "1", min = 0, max = 10) = 0.5
    "Share by which the friction at low angular velocity is larger"
    annotation(__Daest(estimate = true, role = "shape", grid = {0.3, 1}));
  parameter SI.AngularVelocity w_st(min = 1e-12) = 0.1 "Angular velocity over which the excess falls to 1/e"
    annotation(__Daest(estimate = true, role = "shape", of = "w", grid = {0.03, 0.1, 0.3}));
  parameter SI.AngularVelocity w_s(min = 1e-12) = 0.01 "Angular velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "w", grid = {0.01}));
equation
  tau = -tau_c*(1 + b*exp(-(w/w_st)^2))*tanh(w/w_s);
  annotation(
    __Daest(effect = true, attach = "connector", law = "tau = -tau_c*(1 + b*exp(-(w/w_st)^2))*tanh(w/w_s)"),
    Documentation(info = "Lubricated contacts rub more while they stick than while they slide. The
excess b makes stick-slip motion possible. The step of the ideal law is rounded over w_s, which is not
estimated: about 1 % of the range of the angular velocity."));
end StribeckFriction;
