within Daest.Effects.Electrical;
model SaturatingInductance "Inductance that falls with the current"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter SI.Inductance L(min = 0) = 1e-3 "Inductance at small current"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Current i_sat(min = 1e-12) = 1 "Current at which the iron saturates"
    annotation(__Daest(estimate = true, role = "shape", of = "i", grid = {0.3, 0.6, 1}));
  SI.MagneticFlux psi "Flux linkage";
equation
  psi = L*i_sat*tanh(i/i_sat);
  v = der(psi);
  annotation(
    __Daest(effect = true, attach = "series", dynamic = true,
      law = "v = der(psi), psi = L*i_sat*tanh(i/i_sat)"),
    Documentation(info = "The flux of an iron core does not grow for ever."));
end SaturatingInductance;
