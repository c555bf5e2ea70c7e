within Daest.Noise;
model WhiteCurrent "White noise: current in parallel"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter Real intensity(unit = "A2.s", min = 0, start = 1) "Two-sided spectral density of the current";
  input Real w(unit = "A", start = 0) = 0 "White noise: current from pin p to pin n (= i)"
    annotation(__Daest(noise = true, intensity = intensity, estimate = true));
equation
  i = w;
end WhiteCurrent;
