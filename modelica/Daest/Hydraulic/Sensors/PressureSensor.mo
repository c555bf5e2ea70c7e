within Daest.Hydraulic.Sensors;
model PressureSensor "Sensor of the gauge pressure"
  Interfaces.Port_a port "Port whose pressure is measured";
  Daest.Blocks.Interfaces.RealOutput p(unit = "Pa") "Gauge pressure (= port.p) as output signal";
equation
  port.q = 0;
  p = port.p;
end PressureSensor;
