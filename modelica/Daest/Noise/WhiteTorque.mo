within Daest.Noise;
model WhiteTorque "White noise: torque on a flange"
  extends Daest.Mechanics.Rotational.Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter Real intensity(unit = "N2.m2.s", min = 0, start = 1) "Two-sided spectral density of the torque";
  input Real w(unit = "N.m", start = 0) = 0 "White noise: torque that accelerates the flange (= -flange.tau)"
    annotation(__Daest(noise = true, intensity = intensity, estimate = true));
equation
  flange.tau = -w;
end WhiteTorque;
