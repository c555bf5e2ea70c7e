within Daest.Mechanics.Rotational.Components;
model SpringDamper "Linear rotational spring and damper in parallel"
  extends Interfaces.PartialCompliantWithRelativeStates;
  parameter SI.RotationalSpringConstant c(min = 0, start = 1) "Spring constant";
  parameter SI.RotationalDampingConstant d(min = 0, start = 0) "Damping constant";
  parameter SI.Angle phi_rel0 = 0 "Relative angle of the unloaded spring";
protected
  SI.Torque tau_c "Torque of the spring";
  SI.Torque tau_d "Torque of the damper";
equation
  tau_c = c*(phi_rel - phi_rel0);
  tau_d = d*w_rel;
  tau = tau_c + tau_d;
end SpringDamper;
