within Daest.Effects.Translational;
model BoucWenSpring
  "Spring with loops that do not depend on the rate, and bend otherwise on the way out than on the way back"
  extends Daest.Mechanics.Translational.Interfaces.PartialCompliant;
  parameter SI.Force f_h(min = 0) = 1 "Force that the loop is in proportion to"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Position s_h(min = 1e-12) = 0.01 "Deflection over which the loop closes"
    annotation(__Daest(estimate = true, role = "shape", of = "s_rel", grid = {0.03, 0.1, 0.3}));
  parameter Real gamma(unit = "1", min = -2, max = 5) = 1 "Bend of the way out; 0: as on the way back"
    annotation(__Daest(estimate = true, role = "shape", grid = {-1, 1}));
  parameter SI.Velocity v_s(min = 1e-12) = 0.001 "Velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "v_rel", grid = {0.01}));
  SI.Velocity v_rel "Relative velocity (= der(s_rel))";
  Real z(unit = "1", start = 0, stateSelect = StateSelect.prefer) "Place on the loop";
equation
  v_rel = der(s_rel);
  s_h*der(z) = v_rel - v_rel*(tanh(v_rel/v_s)*z + gamma*sqrt(z^2 + 1e-4));
  f = f_h*z;
  annotation(
    __Daest(effect = true, attach = "parallel",
      law = "s_h*der(z) = v_rel - v_rel*(tanh(v_rel/v_s)*z + gamma*sqrt(z^2 + 1e-4)), f = f_h*z"),
    Documentation(info = "Rubber, wire ropes, piezoelectric stages and fluids in a magnetic field (model of
Bouc and Wen): with gamma = 1 the way back is straight, with 0 it is the HystereticSpring, and below -1
the way out gets stiffer without end."));
end BoucWenSpring;
