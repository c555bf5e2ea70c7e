within Daest.Effects.Thermal;
model MeasuredHeatGain "Heat in proportion to a measured irradiance"
  extends Interfaces.PartialPort;
  Daest.Blocks.Interfaces.RealInput u(unit = "W/m2") "Measured irradiance";
  parameter SI.Area A(min = 0) = 1 "Effective area"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  Q_flow = A*u;
  annotation(
    __Daest(effect = true, attach = "connector", inputs = {"u"}, law = "Q_flow = A*u"),
    Documentation(info = "Sun through windows or on walls."));
end MeasuredHeatGain;
