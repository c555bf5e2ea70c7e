within Daest.Effects.Hydraulic;
model LearnedFlow "Volume flow into a component as a curve over a variable of the model"
  extends Daest.Effects.General.Interfaces.PartialLearnedLoad(y(each unit = "m3/s"), load(unit = "m3/s"));
  Daest.Hydraulic.Interfaces.Port_a port "Port of the component";
equation
  port.q = -load;
  annotation(Documentation(info = "For an effect that no other class describes, as daest diagnose writes one:
straight lines between the knots, constant beyond the outermost ones unless the curve has a period. The
model supplies the variable, and the one whose sign counts, by a modifier:
LearnedFlow learned(x = tank.level, …)."));
end LearnedFlow;
