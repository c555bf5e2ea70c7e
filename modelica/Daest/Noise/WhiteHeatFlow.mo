within Daest.Noise;
model WhiteHeatFlow "White noise: heat flow into a port"
  Daest.Thermal.HeatTransfer.Interfaces.HeatPort_b port "Port that delivers the heat";
  parameter Real intensity(unit = "W2.s", min = 0, start = 1) "Two-sided spectral density of the heat flow rate";
  input Real w(unit = "W", start = 0) = 0 "White noise: heat flow rate into what is connected (= -port.Q_flow)"
    annotation(__Daest(noise = true, intensity = intensity, estimate = true));
equation
  port.Q_flow = -w;
end WhiteHeatFlow;
