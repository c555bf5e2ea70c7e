within Daest.Noise;
block White "White noise as a signal"
  extends Daest.Blocks.Interfaces.SO;
  parameter Real intensity(min = 0, start = 1) "Two-sided spectral density of y";
  input Real w(start = 0) = 0 "White noise" annotation(__Daest(noise = true, intensity = intensity, estimate = true));
equation
  y = w;
end White;
