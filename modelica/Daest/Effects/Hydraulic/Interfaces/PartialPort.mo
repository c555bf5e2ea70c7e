within Daest.Effects.Hydraulic.Interfaces;
partial model PartialPort "Effect on the liquid at a port"
  Daest.Hydraulic.Interfaces.Port_a port "Port of the component";
  SI.Pressure p "Gauge pressure (= port.p)";
  SI.VolumeFlowRate q "Volume flow into the component (= -port.q)";
equation
  p = port.p;
  port.q = -q;
end PartialPort;
