within Daest.Noise;
model ColouredVoltage "First-order coloured noise: voltage in series"
  extends Interfaces.PartialColoured;
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter SI.Voltage std(min = 0, start = 1) "Standard deviation of the voltage";
equation
  v = std*x;
end ColouredVoltage;
