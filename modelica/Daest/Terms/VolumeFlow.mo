within Daest.Terms;
model VolumeFlow "Volume flow from a tank or line of known pressure"
  input SI.Pressure p "Gauge pressure";
  Daest.Hydraulic.Interfaces.Port_b port "Port of the tank or line";
  SI.VolumeFlowRate total "Sum of the volume flows into what is connected";
equation
  port.p = p;
  total = -port.q;
end VolumeFlow;
