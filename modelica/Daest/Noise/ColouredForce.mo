within Daest.Noise;
model ColouredForce "First-order coloured noise: force on a flange"
  extends Interfaces.PartialColoured;
  extends Daest.Mechanics.Translational.Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter SI.Force std(min = 0, start = 1) "Standard deviation of the force";
equation
  flange.f = -std*x;
end ColouredForce;
