within Daest.Mechanics.Translational.Components;
model SpringDamper "Linear translational spring and damper in parallel"
  extends Interfaces.PartialCompliantWithRelativeStates;
  parameter SI.TranslationalSpringConstant c(min = 0, start = 1) "Spring constant";
  parameter SI.TranslationalDampingConstant d(min = 0, start = 0) "Damping constant";
  parameter SI.Position s_rel0 = 0 "Relative position of the unloaded spring";
protected
  SI.Force f_c "Force of the spring";
  SI.Force f_d "Force of the damper";
equation
  f_c = c*(s_rel - s_rel0);
  f_d = d*v_rel;
  f = f_c + f_d;
end SpringDamper;
