within Daest.Mechanics.Rotational.Components;
model Damper "Linear rotational damper"
  extends Interfaces.PartialCompliantWithRelativeStates;
  parameter SI.RotationalDampingConstant d(min = 0, start = 0) "Damping constant";
equation
  tau = d*w_rel;
end Damper;
