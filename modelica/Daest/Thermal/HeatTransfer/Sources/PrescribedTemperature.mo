within Daest.Thermal.HeatTransfer.Sources;
model PrescribedTemperature "Port whose temperature is a signal"
  Interfaces.HeatPort_b port "Port whose temperature is prescribed";
  Daest.Blocks.Interfaces.RealInput T(unit = "K") "Temperature of the port as input signal";
equation
  port.T = T;
end PrescribedTemperature;
