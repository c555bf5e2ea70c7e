within Daest.Effects.Rotational;
model LuGreFriction "Dry friction with elastic presliding and a lower friction in motion"
  extends Interfaces.PartialFriction;
  parameter SI.Torque tau_c(min = 0) = 0.01 "Friction torque in motion"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Angle phi_b(min = 1e-12) = 0.1 "Deflection of the bristles at which they slide"
    annotation(__Daest(estimate = true, role = "shape", of = "phi", grid = {0.001, 0.01, 0.1}));
  parameter Real b(unit = "1", min = 0, max = 10) = 0
    "Share by which the friction at low angular velocity is larger"
    annotation(__Daest(estimate = true, role = "shape", grid = {0, 0.5}));
  parameter SI.AngularVelocity w_st(min = 1e-12) = 0.1 "Angular velocity over which the excess falls to 1/e"
    annotation(__Daest(estimate = true, role = "shape", of = "w", grid = {0.1}));
  parameter SI.AngularVelocity w_s(min = 1e-12) = 0.01 "Angular velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "w", grid = {0.01}));
  Real z(unit = "1", start = 0, stateSelect = StateSelect.prefer)
    "Deflection of the bristles over its value in sliding";
equation
  phi_b*der(z) = w - w*tanh(w/w_s)*z/(1 + b*exp(-(w/w_st)^2));
  tau = -tau_c*z;
  annotation(
    __Daest(effect = true, attach = "connector",
      law = "phi_b*der(z) = w - w*tanh(w/w_s)*z/(1 + b*exp(-(w/w_st)^2)), tau = -tau_c*z"),
    Documentation(info = "Canudas de Wit and others, A New Model for Control of Systems with Friction,
1995, with the bristles scaled by their deflection in sliding, so that tau_c = 0 is no friction. Before it
slides, the contact is a spring of stiffness tau_c/phi_b. With b = 0 it is the model of Dahl."));
end LuGreFriction;
