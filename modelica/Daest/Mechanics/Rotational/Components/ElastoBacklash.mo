within Daest.Mechanics.Rotational.Components;
model ElastoBacklash "Spring and damper in parallel behind free play, which push and never pull"
  extends Interfaces.PartialCompliantWithRelativeStates;
  parameter SI.RotationalSpringConstant c(min = 0, start = 1) "Spring constant";
  parameter SI.RotationalDampingConstant d(min = 0, start = 0) "Damping constant";
  parameter SI.Angle b(min = 0, start = 0.01) "Free play from stop to stop";
  parameter SI.Angle phi_rel0 = 0 "Relative angle in the middle of the play";
protected
  parameter SI.Angle phi_s = 0.02*b + 1e-6 "Angle over which contact begins";
  SI.Angle x "Deflection from the middle";
  SI.Torque tau_r "Torque of spring and damper at the right stop";
  SI.Torque tau_l "Torque of spring and damper at the left stop";
equation
  x = phi_rel - phi_rel0;
  tau_r = c*(x - b/2) + d*w_rel;
  tau_l = -c*(x + b/2) - d*w_rel;
  tau = (1 + tanh((x - b/2)/phi_s))/4*(tau_r + sqrt(tau_r^2 + (c*phi_s)^2))
    - (1 + tanh((-x - b/2)/phi_s))/4*(tau_l + sqrt(tau_l^2 + (c*phi_s)^2));
  annotation(Documentation(info = "At a stop spring and damper act together, as long as they push: when the
contact opens, the damper does not hold it. The kinks are rounded over 2 % of the play."));
end ElastoBacklash;
