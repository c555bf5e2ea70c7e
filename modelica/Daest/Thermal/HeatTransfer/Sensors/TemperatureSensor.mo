within Daest.Thermal.HeatTransfer.Sensors;
model TemperatureSensor "Sensor of the absolute temperature"
  Daest.Blocks.Interfaces.RealOutput T(unit = "K") "Absolute temperature (= port.T) as output signal";
  Interfaces.HeatPort_a port "Port whose temperature is measured";
equation
  T = port.T;
  port.Q_flow = 0;
end TemperatureSensor;
