within Daest.Effects.Translational;
model Backlash "Free play in series with a spring"
  extends Daest.Mechanics.Translational.Interfaces.PartialCompliant;
  parameter SI.Position gap(min = 0) = 0.001 "Free play from stop to stop"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real lift(unit = "1", min = 0, max = 1) = 1
    "1 if the damper stands behind the play together with the spring, 0 if it bridges the play"
    annotation(__Daest(role = "shape", grid = {1, 0}));
  parameter SI.Position s_s(min = 1e-12) = 1e-5 "Deflection over which contact begins"
    annotation(__Daest(role = "sharpness", of = "s_rel", grid = {0.01}));
  parameter SI.TranslationalSpringConstant c(min = 0) = 1 "Stiffness of the spring that has the play"
    annotation(__Daest(role = "given", from = "c", required = true));
  parameter SI.TranslationalDampingConstant d(min = 0) = 0 "Damping constant of the damper beside the spring"
    annotation(__Daest(role = "given", from = "d"));
  parameter SI.Position s_rel0 = 0 "Deflection of the unloaded spring"
    annotation(__Daest(role = "given", from = "s_rel0"));
  SI.Velocity v_rel "Relative velocity (= der(s_rel))";
  SI.Position x "Deflection from rest (= s_rel - s_rel0)";
  SI.Position s_c "Deflection of the spring itself";
equation
  v_rel = der(s_rel);
  x = s_rel - s_rel0;
  s_c = x + (sqrt((x - gap/2)^2 + s_s^2) - sqrt((x + gap/2)^2 + s_s^2))/2;
  f = c*(s_c - x)
    + lift*d*v_rel*((x - gap/2)/sqrt((x - gap/2)^2 + s_s^2) - (x + gap/2)/sqrt((x + gap/2)^2 + s_s^2))/2;
  annotation(
    __Daest(effect = true, attach = "parallel",
      law = "f = c*(s_c - x) + lift*d*(der(s_c) - v_rel), s_c = x less the play"),
    Documentation(info = "It takes away from the spring in parallel to it what the spring does not do
within the play, so that both together give c*s_c with s_c = 0 for |x| < gap/2 and x -+ gap/2 beyond. c and
d are those of the spring. The kinks are rounded over s_s; gap = 0 is exactly the spring without play."));
end Backlash;
