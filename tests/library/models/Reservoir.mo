model Reservoir "A tank filled by a pump and drained through a line against a pressure"
  Daest.Blocks.Interfaces.RealInput q(unit = "m3/s", start = 0) "Flow of the pump";
  Daest.Blocks.Interfaces.RealOutput level(unit = "m") "Level of the tank";
  Daest.Blocks.Interfaces.RealOutput p(unit = "Pa") "Pressure at the bottom";
  Daest.Blocks.Interfaces.RealOutput q_out(unit = "m3/s") "Flow out of the tank";

  Daest.Hydraulic.Sources.PrescribedFlow pump "Pump";
  Daest.Hydraulic.Components.Tank tank(A = 0.02, rho = 1000, g = 10) "Tank";
  Daest.Hydraulic.Sensors.FlowSensor flow_meter "Flow meter";
  Daest.Hydraulic.Components.LinearResistance line(R = 1e6) "Line";
  Daest.Hydraulic.Sources.FixedPressure sink(p = 500) "Sink";
  Daest.Hydraulic.Sensors.LevelSensor gauge(rho = 1000, g = 10) "Level gauge";
  Daest.Hydraulic.Sensors.PressureSensor manometer "Manometer";
  Daest.Noise.WhiteVolumeFlow white(intensity = 1) "Noise";
  Daest.Noise.ColouredVolumeFlow coloured(std = 2, T = 5) "Noise";
equation
  connect(q, pump.q);
  connect(pump.port, tank.inlet);
  connect(white.port, tank.inlet);
  connect(coloured.port, tank.inlet);
  connect(tank.outlet, flow_meter.port_a);
  connect(flow_meter.port_b, line.port_a);
  connect(line.port_b, sink.port);
  connect(gauge.port, tank.outlet);
  connect(manometer.port, tank.outlet);
  connect(gauge.level, level);
  connect(manometer.p, p);
  connect(flow_meter.q, q_out);
end Reservoir;
