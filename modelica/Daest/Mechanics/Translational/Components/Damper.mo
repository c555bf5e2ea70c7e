within Daest.Mechanics.Translational.Components;
model Damper "Linear translational damper"
  extends Interfaces.PartialCompliantWithRelativeStates;
  parameter SI.TranslationalDampingConstant d(min = 0, start = 0) "Damping constant";
equation
  f = d*v_rel;
end Damper;
