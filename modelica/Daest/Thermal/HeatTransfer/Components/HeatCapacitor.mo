within Daest.Thermal.HeatTransfer.Components;
model HeatCapacitor "Lumped storage of heat"
  parameter SI.HeatCapacity C(min = 0) "Heat capacity of the element";
  SI.Temperature T(start = 293.15, stateSelect = StateSelect.prefer) "Temperature of the element (= port.T)";
  SI.TemperatureSlope der_T "Time derivative of the temperature (= der(T))";
  Interfaces.HeatPort_a port "Port of the element";
equation
  T = port.T;
  der_T = der(T);
  C*der_T = port.Q_flow;
end HeatCapacitor;
