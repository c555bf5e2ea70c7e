within Daest.Thermal.HeatTransfer.Sensors;
model RelTemperatureSensor "Sensor of the temperature difference between two ports"
  Interfaces.HeatPort_a port_a "Left port";
  Interfaces.HeatPort_b port_b "Right port";
  Daest.Blocks.Interfaces.RealOutput T_rel(unit = "K")
    "Temperature difference (= port_a.T - port_b.T) as output signal";
equation
  T_rel = port_a.T - port_b.T;
  0 = port_a.Q_flow;
  0 = port_b.Q_flow;
end RelTemperatureSensor;
