within Daest.Noise;
block Coloured "First-order coloured noise as a signal"
  extends Interfaces.PartialColoured;
  extends Daest.Blocks.Interfaces.SO;
  parameter Real std(min = 0, start = 1) "Standard deviation of y";
equation
  y = std*x;
end Coloured;
