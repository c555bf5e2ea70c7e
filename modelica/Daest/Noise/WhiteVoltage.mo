within Daest.Noise;
model WhiteVoltage "White noise: voltage in series"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter Real intensity(unit = "V2.s", min = 0, start = 1) "Two-sided spectral density of the voltage";
  input Real w(unit = "V", start = 0) = 0 "White noise: voltage drop from pin p to pin n (= v)"
    annotation(__Daest(noise = true, intensity = intensity, estimate = true));
equation
  v = w;
end WhiteVoltage;
