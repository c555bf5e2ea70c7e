within Daest.Thermal.HeatTransfer.Celsius;
model FixedTemperature "Port of fixed temperature in degree Celsius"
  parameter Real T(unit = "degC") "Fixed temperature of the port";
  Interfaces.HeatPort_b port "Port that is held";
equation
  port.T = T - Daest.Constants.T_zero;
end FixedTemperature;
