within Daest.Thermal.HeatTransfer.Sources;
model FixedTemperature "Port of fixed temperature"
  parameter SI.Temperature T "Fixed temperature of the port";
  Interfaces.HeatPort_b port "Port that is held";
equation
  port.T = T;
end FixedTemperature;
