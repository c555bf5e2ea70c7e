within Daest.Effects.Rotational;
model BoucWenSpring
  "Spring with loops that do not depend on the rate, and bend otherwise on the way out than on the way back"
  extends Daest.Mechanics.Rotational.Interfaces.PartialCompliant;
  parameter SI.Torque tau_h(min = 0) = 0.01 "Torque that the loop is in proportion to"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Angle phi_h(min = 1e-12) = 0.1 "Deflection over which the loop closes"
    annotation(__Daest(estimate = true, role = "shape", of = "phi_rel", grid = {0.03, 0.1, 0.3}));
  parameter Real gamma(unit = "1", min = -2, max = 5) = 1 "Bend of the way out; 0: as on the way back"
    annotation(__Daest(estimate = true, role = "shape", grid = {-1, 1}));
  parameter SI.AngularVelocity w_s(min = 1e-12) = 0.01 "Angular velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "w_rel", grid = {0.01}));
  SI.AngularVelocity w_rel "Relative angular velocity (= der(phi_rel))";
  Real z(unit = "1", start = 0, stateSelect = StateSelect.prefer) "Place on the loop";
equation
  w_rel = der(phi_rel);
  phi_h*der(z) = w_rel - w_rel*(tanh(w_rel/w_s)*z + gamma*sqrt(z^2 + 1e-4));
  tau = tau_h*z;
  annotation(
    __Daest(effect = true, attach = "parallel",
      law = "phi_h*der(z) = w_rel - w_rel*(tanh(w_rel/w_s)*z + gamma*sqrt(z^2 + 1e-4)), tau = tau_h*z"),
    Documentation(info = "Rubber, wire ropes, piezoelectric stages and fluids in a magnetic field (model of
Bouc and Wen): with gamma = 1 the way back is straight, with 0 it is the HystereticSpring, and below -1
the way out gets stiffer without end."));
end BoucWenSpring;
