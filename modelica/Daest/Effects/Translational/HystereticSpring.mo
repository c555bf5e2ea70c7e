within Daest.Effects.Translational;
model HystereticSpring
  "Spring whose force lags behind the deflection, with loops that do not depend on the rate"
  extends Daest.Mechanics.Translational.Interfaces.PartialCompliant;
  parameter SI.Force f_h(min = 0) = 1 "Half of the height of the loop"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Position s_h(min = 1e-12) = 0.01 "Deflection over which the loop closes"
    annotation(__Daest(estimate = true, role = "shape", of = "s_rel", grid = {0.03, 0.1, 0.3}));
  parameter SI.Velocity v_s(min = 1e-12) = 0.001 "Velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "v_rel", grid = {0.01}));
  SI.Velocity v_rel "Relative velocity (= der(s_rel))";
  Real z(unit = "1", start = 0, stateSelect = StateSelect.prefer) "Place on the loop, -1 to 1";
equation
  v_rel = der(s_rel);
  s_h*der(z) = v_rel - v_rel*tanh(v_rel/v_s)*z;
  f = f_h*z;
  annotation(
    __Daest(effect = true, attach = "parallel",
      law = "s_h*der(z) = v_rel - v_rel*tanh(v_rel/v_s)*z, f = f_h*z"),
    Documentation(info = "Rubber, cables and harmonic drives lose the same energy in every cycle, slow
or fast (model of Dahl, Bouc and Wen)."));
end HystereticSpring;
