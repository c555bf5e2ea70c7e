within Daest.Terms;
model HeatFlow "Heat flow from a body of known temperature"
  input SI.Temperature T "Temperature of the body";
  Daest.Thermal.HeatTransfer.Interfaces.HeatPort_b port "Port of the body";
  SI.HeatFlowRate total "Sum of the heat flows into what is connected";
equation
  port.T = T;
  total = -port.Q_flow;
end HeatFlow;
