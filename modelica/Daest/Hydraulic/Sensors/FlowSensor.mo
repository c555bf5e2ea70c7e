within Daest.Hydraulic.Sensors;
model FlowSensor "Sensor of the flow between two ports"
  Interfaces.Port_a port_a "Left port";
  Interfaces.Port_b port_b "Right port";
  Daest.Blocks.Interfaces.RealOutput q(unit = "m3/s")
    "Volume flow rate from port_a to port_b (= port_a.q) as output signal";
equation
  port_a.p = port_b.p;
  port_a.q + port_b.q = 0;
  q = port_a.q;
end FlowSensor;
