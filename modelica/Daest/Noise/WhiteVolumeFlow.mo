within Daest.Noise;
model WhiteVolumeFlow "White noise: volume flow into a port"
  Daest.Hydraulic.Interfaces.Port_b port "Port that delivers the flow";
  parameter Real intensity(unit = "m6/s", min = 0, start = 1) "Two-sided spectral density of the volume flow rate";
  input Real w(unit = "m3/s", start = 0) = 0 "White noise: volume flow rate into what is connected (= -port.q)"
    annotation(__Daest(noise = true, intensity = intensity, estimate = true));
equation
  port.q = -w;
end WhiteVolumeFlow;
