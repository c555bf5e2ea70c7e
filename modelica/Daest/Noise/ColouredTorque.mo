within Daest.Noise;
model ColouredTorque "First-order coloured noise: torque on a flange"
  extends Interfaces.PartialColoured;
  extends Daest.Mechanics.Rotational.Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter SI.Torque std(min = 0, start = 1) "Standard deviation of the torque";
equation
  flange.tau = -std*x;
end ColouredTorque;
