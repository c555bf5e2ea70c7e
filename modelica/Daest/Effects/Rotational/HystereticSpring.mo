within Daest.Effects.Rotational;
model HystereticSpring
  "Spring whose torque lags behind the deflection, with loops that do not depend on the rate"
  extends Daest.Mechanics.Rotational.Interfaces.PartialCompliant;
  parameter SI.Torque tau_h(min = 0) = 0.01 "Half of the height of the loop"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Angle phi_h(min = 1e-12) = 0.1 "Deflection over which the loop closes"
    annotation(__Daest(estimate = true, role = "shape", of = "phi_rel", grid = {0.03, 0.1, 0.3}));
  parameter SI.AngularVelocity w_s(min = 1e-12) = 0.01 "Angular velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "w_rel", grid = {0.01}));
  SI.AngularVelocity w_rel "Relative angular velocity (= der(phi_rel))";
  Real z(unit = "1", start = 0, stateSelect = StateSelect.prefer) "Place on the loop, -1 to 1";
equation
  w_rel = der(phi_rel);
  phi_h*der(z) = w_rel - w_rel*tanh(w_rel/w_s)*z;
  tau = tau_h*z;
  annotation(
    __Daest(effect = true, attach = "parallel",
      law = "phi_h*der(z) = w_rel - w_rel*tanh(w_rel/w_s)*z, tau = tau_h*z"),
    Documentation(info = "Rubber, cables and harmonic drives lose the same energy in every cycle, slow
or fast (model of Dahl, Bouc and Wen)."));
end HystereticSpring;
