within Daest.Thermal.HeatTransfer.Celsius;
model PrescribedTemperature "Port whose temperature is a signal in degree Celsius"
  Interfaces.HeatPort_b port "Port whose temperature is prescribed";
  Daest.Blocks.Interfaces.RealInput T(unit = "degC") "Temperature of the port as input signal";
equation
  port.T = T - Daest.Constants.T_zero;
end PrescribedTemperature;
