within Daest.Effects.Rotational;
model RelaxingSpring "Spring whose torque fades while it is held, such as rubber"
  extends Daest.Mechanics.Rotational.Interfaces.PartialCompliant;
  parameter SI.RotationalSpringConstant c(min = 0) = 1 "Stiffness that fades"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-9) = 0.1 "Time over which it fades: damping in series over stiffness"
    annotation(__Daest(estimate = true, role = "shape", of = "time", grid = {0.0005, 0.002, 0.01, 0.05, 0.2}));
  SI.Angle x(start = 0, stateSelect = StateSelect.prefer) "Deflection that has not faded yet";
equation
  T*der(x) = T*der(phi_rel) - x;
  tau = c*x;
  annotation(
    __Daest(effect = true, attach = "parallel", law = "T*der(x) = T*der(phi_rel) - x, tau = c*x"),
    Documentation(info = "A spring and a damper in series (Maxwell), beside what the model has: rubber mounts, bushes and
couplings are stiffer against what is fast, with a loss of their own. At the start nothing is left of what held it before."));
end RelaxingSpring;
