within Daest.Effects.Thermal;
model LearnedHeatFlow "Heat flow into a body as a curve over a variable of the model"
  extends Daest.Effects.General.Interfaces.PartialLearnedLoad(y(each unit = "W"), load(unit = "W"));
  Daest.Thermal.HeatTransfer.Interfaces.HeatPort_a port "Port of the body";
equation
  port.Q_flow = -load;
  annotation(Documentation(info = "For an effect that no other class describes, as daest diagnose writes one:
straight lines between the knots, constant beyond the outermost ones unless the curve has a period. The
model supplies the variable, and the one whose sign counts, by a modifier:
LearnedHeatFlow learned(x = body.T, …)."));
end LearnedHeatFlow;
