within Daest.Effects.Thermal;
model MeasuredHeatFlow "Heat in proportion to a measured signal"
  extends Interfaces.PartialPort;
  Daest.Blocks.Interfaces.RealInput u "Measured signal";
  parameter Real k = 1 "Heat flow per unit of the signal"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  Q_flow = k*u;
  annotation(
    __Daest(effect = true, attach = "connector", inputs = {"u"}, law = "Q_flow = k*u"),
    Documentation(info = "A recorded signal that the model has not used so far heats the body."));
end MeasuredHeatFlow;
