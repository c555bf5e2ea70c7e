within Daest.Effects.Thermal;
model HeatLoss "Flow of heat into surroundings of constant temperature"
  extends Interfaces.PartialPort;
  parameter SI.ThermalConductance G(min = 0) = 1 "Thermal conductance to the surroundings"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Temperature T_0(min = 233.15, max = 333.15) = 293.15 "Temperature of the surroundings"
    annotation(__Daest(estimate = true, role = "shape", grid = {283.15, 293.15, 303.15}));
equation
  Q_flow = -G*(port.T - T_0);
  annotation(
    __Daest(effect = true, attach = "connector", law = "Q_flow = -G*(port.T - T_0)"),
    Documentation(info = "A jacket, a pipe or a housing that loses heat to a hall or a cellar whose temperature nobody
recorded, or gains heat from it."));
end HeatLoss;
