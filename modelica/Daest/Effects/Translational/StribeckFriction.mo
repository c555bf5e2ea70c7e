within Daest.Effects.Translational;
model StribeckFriction "Dry friction that is larger at low velocity"
  extends Interfaces.PartialFriction;
  parameter SI.Force f_c(min = 0) = 1 "Friction force at high velocity"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real b(unit = "1", min = 0, max = 10) = 0.5
    "Share by which the friction at low velocity is larger"
    annotation(__Daest(estimate = true, role = "shape", grid = {0.3, 1}));
  parameter SI.Velocity v_st(min = 1e-12) = 0.01 "Velocity over which the excess falls to 1/e"
    annotation(__Daest(estimate = true, role = "shape", of = "v", grid = {0.03, 0.1, 0.3}));
  parameter SI.Velocity v_s(min = 1e-12) = 0.001 "Velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "v", grid = {0.01}));
equation
  f = -f_c*(1 + b*exp(-(v/v_st)^2))*tanh(v/v_s);
  annotation(
    __Daest(effect = true, attach = "connector", law = "f = -f_c*(1 + b*exp(-(v/v_st)^2))*tanh(v/v_s)"),
    Documentation(info = "Lubricated contacts rub more while they stick than while they slide. The
excess b makes stick-slip motion possible. The step of the ideal law is rounded over v_s, which is not
estimated: about 1 % of the range of the velocity."));
end StribeckFriction;
