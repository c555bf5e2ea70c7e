within Daest.Thermal.HeatTransfer.Interfaces;
partial model Element1D "Transport of heat between two ports, without storage"
  SI.HeatFlowRate Q_flow "Heat flow rate from port_a to port_b (= port_a.Q_flow)";
  SI.TemperatureDifference dT "Temperature difference (= port_a.T - port_b.T)";
  HeatPort_a port_a "Left port";
  HeatPort_b port_b "Right port";
equation
  dT = port_a.T - port_b.T;
  port_a.Q_flow = Q_flow;
  port_b.Q_flow = -Q_flow;
end Element1D;
