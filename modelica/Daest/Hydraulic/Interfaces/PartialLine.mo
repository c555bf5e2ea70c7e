within Daest.Hydraulic.Interfaces;
partial model PartialLine "Transport of liquid between two ports, without storage"
  SI.VolumeFlowRate q "Volume flow rate from port_a to port_b (= port_a.q)";
  SI.Pressure dp "Pressure drop (= port_a.p - port_b.p)";
  Port_a port_a "Left port";
  Port_b port_b "Right port";
equation
  dp = port_a.p - port_b.p;
  port_a.q = q;
  port_b.q = -q;
end PartialLine;
