within Daest.Effects.Amounts;
model LearnedInflow "Inflow into a store as a curve over a variable of the model"
  extends Daest.Effects.General.Interfaces.PartialLearnedLoad;
  Interfaces.Port port "Store";
equation
  port.inflow = -load;
  annotation(Documentation(info = "For an effect that no other class describes, as daest diagnose writes one:
straight lines between the knots, constant beyond the outermost ones unless the curve has a period. The
model supplies the variable, and the one whose sign counts, by a modifier:
LearnedInflow learned(x = substrate, …)."));
end LearnedInflow;
