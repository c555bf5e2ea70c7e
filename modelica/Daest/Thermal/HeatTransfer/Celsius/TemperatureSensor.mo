within Daest.Thermal.HeatTransfer.Celsius;
model TemperatureSensor "Sensor of the absolute temperature in degree Celsius"
  Daest.Blocks.Interfaces.RealOutput T(unit = "degC") "Temperature in degree Celsius as output signal";
  Interfaces.HeatPort_a port "Port whose temperature is measured";
equation
  T = port.T + Daest.Constants.T_zero;
  port.Q_flow = 0;
end TemperatureSensor;
