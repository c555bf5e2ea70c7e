within Daest.Effects.Hydraulic;
model MeasuredFlow "Flow in proportion to a measured signal"
  extends Interfaces.PartialPort;
  Daest.Blocks.Interfaces.RealInput u "Measured signal";
  parameter Real k = 1e-6 "Volume flow per unit of the signal"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  q = k*u;
  annotation(
    __Daest(effect = true, attach = "connector", inputs = {"u"}, law = "q = k*u"),
    Documentation(info = "A recorded signal that the model has not used so far feeds the system."));
end MeasuredFlow;
