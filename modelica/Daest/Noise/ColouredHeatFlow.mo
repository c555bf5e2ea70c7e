within Daest.Noise;
model ColouredHeatFlow "First-order coloured noise: heat flow into a port"
  extends Interfaces.PartialColoured;
  Daest.Thermal.HeatTransfer.Interfaces.HeatPort_b port "Port that delivers the heat";
  parameter SI.HeatFlowRate std(min = 0, start = 1) "Standard deviation of the heat flow rate";
equation
  port.Q_flow = -std*x;
end ColouredHeatFlow;
