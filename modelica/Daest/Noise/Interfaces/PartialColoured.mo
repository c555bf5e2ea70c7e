within Daest.Noise.Interfaces;
partial model PartialColoured "Normalised first-order coloured noise"
  parameter SI.Time T(min = 0, start = 1) "Correlation time of the noise";
  Real x(unit = "1", start = 0, stateSelect = StateSelect.prefer)
    "Coloured noise of variance 1 (T*der(x) + x = sqrt(2*T)*w)";
  input Real w(unit = "1", start = 0) = 0 "White noise that drives the filter, intensity 1 s"
    annotation(__Daest(noise = true, intensity = 1));
protected
  constant SI.Time second = 1 "Makes the equation hold in units";
equation
  T*der(x) + x = sqrt(2*T/second)*w;
end PartialColoured;
