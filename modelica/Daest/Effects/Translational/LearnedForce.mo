within Daest.Effects.Translational;
model LearnedForce "Force on a body as a curve over a variable of the model"
  extends Daest.Effects.General.Interfaces.PartialLearnedLoad(y(each unit = "N"), load(unit = "N"));
  Daest.Mechanics.Translational.Interfaces.Flange_b flange "Flange of the body";
equation
  flange.f = -load;
  annotation(Documentation(info = "For an effect that no other class describes, as daest diagnose writes one:
straight lines between the knots, constant beyond the outermost ones unless the curve has a period. The
model supplies the variable, and the one whose sign counts, by a modifier:
LearnedForce learned(x = sledge.s, s = sledge.v, …)."));
end LearnedForce;
