within Daest.Effects.Electrical;
model LearnedVoltage "Voltage as a curve over the current"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  constant Integer n_knots = 9 "Number of knots";
  parameter SI.Voltage y[n_knots] = zeros(n_knots) "Voltage drop at the knots"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Current i_max(min = 1e-12) = 1 "Current of the outermost knots, which lie at -i_max and i_max"
    annotation(__Daest(role = "shape", of = "i", grid = {1}));
equation
  v = sum(
    y[k]*noEvent(max(0, 1 - abs(1 + (n_knots - 1)*(1 + max(-1, min(1, i/i_max)))/2 - k))) for k in 1:n_knots);
  annotation(
    __Daest(effect = true, attach = "series",
      law = "v = curve(i), straight lines between the knots from -i_max to i_max"),
    Documentation(info = "For an effect that no other class describes. Beyond the outermost knots the
curve is constant."));
end LearnedVoltage;
