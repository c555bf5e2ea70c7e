within Daest.Effects.Thermal.Interfaces;
partial model PartialPort "Effect on the heat of a body"
  Daest.Thermal.HeatTransfer.Interfaces.HeatPort_a port "Port of the body";
  SI.HeatFlowRate Q_flow "Heat flow into the body (= -port.Q_flow)";
equation
  port.Q_flow = -Q_flow;
end PartialPort;
