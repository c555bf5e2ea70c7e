within Daest.Mechanics.Translational.Components;
model Spring "Linear translational spring"
  extends Interfaces.PartialCompliant;
  parameter SI.TranslationalSpringConstant c(min = 0, start = 1) "Spring constant";
  parameter SI.Position s_rel0 = 0 "Relative position of the unloaded spring";
equation
  f = c*(s_rel - s_rel0);
end Spring;
