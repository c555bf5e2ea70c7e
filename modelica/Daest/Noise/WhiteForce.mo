within Daest.Noise;
model WhiteForce "White noise: force on a flange"
  extends Daest.Mechanics.Translational.Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter Real intensity(unit = "N2.s", min = 0, start = 1) "Two-sided spectral density of the force";
  input Real w(unit = "N", start = 0) = 0 "White noise: force that accelerates the flange (= -flange.f)"
    annotation(__Daest(noise = true, intensity = intensity, estimate = true));
equation
  flange.f = -w;
end WhiteForce;
