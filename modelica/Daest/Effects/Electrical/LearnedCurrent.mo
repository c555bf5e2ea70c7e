within Daest.Effects.Electrical;
model LearnedCurrent "Current into a node as a curve over a variable of the model"
  extends Daest.Effects.General.Interfaces.PartialLearnedLoad(y(each unit = "A"), load(unit = "A"));
  Daest.Electrical.Analog.Interfaces.PositivePin pin "Pin at the node";
equation
  pin.i = -load;
  annotation(Documentation(info = "For an effect that no other class describes, as daest diagnose writes one:
straight lines between the knots, constant beyond the outermost ones unless the curve has a period. The
model supplies the variable, and the one whose sign counts, by a modifier:
LearnedCurrent learned(x = rotor.phi, …)."));
end LearnedCurrent;
