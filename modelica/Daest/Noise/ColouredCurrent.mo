within Daest.Noise;
model ColouredCurrent "First-order coloured noise: current in parallel"
  extends Interfaces.PartialColoured;
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter SI.Current std(min = 0, start = 1) "Standard deviation of the current";
equation
  i = std*x;
end ColouredCurrent;
