within Daest.Effects.Rotational;
model Backlash "Free play in series with a spring"
  extends Daest.Mechanics.Rotational.Interfaces.PartialCompliant;
  parameter SI.Angle gap(min = 0) = 0.01 "Free play from stop to stop"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real lift(unit = "1", min = 0, max = 1) = 1
    "1 if the damper stands behind the play together with the spring, 0 if it bridges the play"
    annotation(__Daest(role = "shape", grid = {1, 0}));
  parameter SI.Angle phi_s(min = 1e-12) = 1e-4 "Deflection over which contact begins"
    annotation(__Daest(role = "sharpness", of = "phi_rel", grid = {0.01}));
  parameter SI.RotationalSpringConstant c(min = 0) = 1 "Stiffness of the spring that has the play"
    annotation(__Daest(role = "given", from = "c", required = true));
  parameter SI.RotationalDampingConstant d(min = 0) = 0 "Damping constant of the damper beside the spring"
    annotation(__Daest(role = "given", from = "d"));
  parameter SI.Angle phi_rel0 = 0 "Deflection of the unloaded spring"
    annotation(__Daest(role = "given", from = "phi_rel0"));
  SI.AngularVelocity w_rel "Relative angular velocity (= der(phi_rel))";
  SI.Angle x "Deflection from rest (= phi_rel - phi_rel0)";
  SI.Angle phi_c "Deflection of the spring itself";
equation
  w_rel = der(phi_rel);
  x = phi_rel - phi_rel0;
  phi_c = x + (sqrt((x - gap/2)^2 + phi_s^2) - sqrt((x + gap/2)^2 + phi_s^2))/2;
  tau = c*(phi_c - x)
    + lift*d*w_rel*((x - gap/2)/sqrt((x - gap/2)^2 + phi_s^2) - (x + gap/2)/sqrt((x + gap/2)^2 + phi_s^2))/2;
  annotation(
    __Daest(effect = true, attach = "parallel",
      law = "tau = c*(phi_c - x) + lift*d*(der(phi_c) - w_rel), phi_c = x less the play"),
    Documentation(info = "It takes away from the spring in parallel to it what the spring does not do
within the play, so that both together give c*phi_c with phi_c = 0 for |x| < gap/2 and x -+ gap/2 beyond. c
and d are those of the spring. The kinks are rounded over phi_s; gap = 0 is exactly the spring without play."));
end Backlash;
