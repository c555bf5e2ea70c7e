within Daest.Thermal.HeatTransfer.Sensors;
model HeatFlowSensor "Sensor of the heat flow between two ports"
  Interfaces.HeatPort_a port_a "Left port";
  Interfaces.HeatPort_b port_b "Right port";
  Daest.Blocks.Interfaces.RealOutput Q_flow(unit = "W")
    "Heat flow rate from port_a to port_b (= port_a.Q_flow) as output signal";
equation
  port_a.T = port_b.T;
  port_a.Q_flow + port_b.Q_flow = 0;
  Q_flow = port_a.Q_flow;
end HeatFlowSensor;
