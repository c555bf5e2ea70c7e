within Daest.Effects.Thermal;
model MeasuredSurroundings "Flow of heat to surroundings whose temperature is recorded"
  extends Interfaces.PartialPort;
  Daest.Blocks.Interfaces.RealInput u(unit="K") "Recorded temperature";
  parameter SI.ThermalConductance G(min = 0) = 1 "Thermal conductance to the surroundings"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  Q_flow = -G*(port.T - u);
  annotation(
    __Daest(effect = true, attach = "connector", inputs = {"u"}, law = "Q_flow = -G*(port.T - u)"),
    Documentation(info = "A wall to the next room, to the ground or to the outside: somebody recorded its temperature, and the
model does not use it. Where the other body is no larger than this one, a cause that warms both and is not
recorded would look alike."));
end MeasuredSurroundings;
