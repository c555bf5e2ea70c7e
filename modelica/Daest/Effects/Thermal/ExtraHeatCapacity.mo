within Daest.Effects.Thermal;
model ExtraHeatCapacity "Second mass that takes up heat with delay, such as a wall behind a room"
  extends Interfaces.PartialPort;
  parameter SI.ThermalConductance G(min = 0) = 1 "Thermal conductance to the mass"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-9) = 1000 "Time constant of the mass: its heat capacity over G"
    annotation(__Daest(estimate = true, role = "shape", of = "time", grid = {0.003, 0.01, 0.03, 0.1, 0.3}));
  SI.TemperatureDifference z(start = 0, stateSelect = StateSelect.prefer)
    "Temperature of the body over that of the mass; zero after a long rest";
equation
  T*der(z) = T*der(port.T) - z;
  Q_flow = -G*z;
  annotation(
    __Daest(effect = true, attach = "connector", law = "T*der(z) = T*der(port.T) - z, Q_flow = -G*z"),
    Documentation(info = "Walls, housings and supports warm up behind what is measured. The heat
capacity of the mass is G*T. At the start it has the temperature of the body."));
end ExtraHeatCapacity;
