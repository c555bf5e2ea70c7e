within Daest.Noise;
model ColouredVolumeFlow "First-order coloured noise: volume flow into a port"
  extends Interfaces.PartialColoured;
  Daest.Hydraulic.Interfaces.Port_b port "Port that delivers the flow";
  parameter SI.VolumeFlowRate std(min = 0, start = 1) "Standard deviation of the volume flow rate";
equation
  port.q = -std*x;
end ColouredVolumeFlow;
