within Daest.Effects.Translational;
model LuGreFriction "Dry friction with elastic presliding and a lower friction in motion"
  extends Interfaces.PartialFriction;
  parameter SI.Force f_c(min = 0) = 1 "Friction force in motion"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Position s_b(min = 1e-12) = 0.01 "Deflection of the bristles at which they slide"
    annotation(__Daest(estimate = true, role = "shape", of = "s", grid = {0.001, 0.01, 0.1}));
  parameter Real b(unit = "1", min = 0, max = 10) = 0 "Share by which the friction at low velocity is larger"
    annotation(__Daest(estimate = true, role = "shape", grid = {0, 0.5}));
  parameter SI.Velocity v_st(min = 1e-12) = 0.01 "Velocity over which the excess falls to 1/e"
    annotation(__Daest(estimate = true, role = "shape", of = "v", grid = {0.1}));
  parameter SI.Velocity v_s(min = 1e-12) = 0.001 "Velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "v", grid = {0.01}));
  Real z(unit = "1", start = 0, stateSelect = StateSelect.prefer)
    "Deflection of the bristles over its value in sliding";
equation
  s_b*der(z) = v - v*tanh(v/v_s)*z/(1 + b*exp(-(v/v_st)^2));
  f = -f_c*z;
  annotation(
    __Daest(effect = true, attach = "connector",
      law = "s_b*der(z) = v - v*tanh(v/v_s)*z/(1 + b*exp(-(v/v_st)^2)), f = -f_c*z"),
    Documentation(info = "Canudas de Wit and others, A New Model for Control of Systems with Friction,
1995, with the bristles scaled by their deflection in sliding, so that f_c = 0 is no friction. Before it
slides, the contact is a spring of stiffness f_c/s_b. With b = 0 it is the model of Dahl."));
end LuGreFriction;
