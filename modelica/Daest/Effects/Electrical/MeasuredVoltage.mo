within Daest.Effects.Electrical;
model MeasuredVoltage "Voltage in proportion to a measured signal"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  Daest.Blocks.Interfaces.RealInput u "Measured signal";
  parameter Real k = 0.1 "Voltage per unit of the signal"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  v = k*u;
  annotation(
    __Daest(effect = true, attach = "series", inputs = {"u"}, law = "v = k*u"),
    Documentation(info = "A recorded signal that the model has not used so far enters the loop."));
end MeasuredVoltage;
