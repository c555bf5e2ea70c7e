within Daest.Effects.Translational;
model LearnedSpring "Force as a curve over the position"
  extends Interfaces.PartialRelative;
  constant Integer n_knots = 9 "Number of knots";
  parameter SI.Force y[n_knots] = zeros(n_knots) "Force against the deflection at the knots"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Position s_max(min = 1e-12) = 1
    "Position of the outermost knots, which lie at -s_max and s_max"
    annotation(__Daest(role = "shape", of = "s", grid = {1}));
equation
  f = -sum(
    y[k]*noEvent(max(0, 1 - abs(1 + (n_knots - 1)*(1 + max(-1, min(1, s/s_max)))/2 - k))) for k in 1:n_knots);
  annotation(
    __Daest(effect = true, attach = "connector",
      law = "f = -curve(s), straight lines between the knots from -s_max to s_max"),
    Documentation(info = "For an effect that no other class describes. Beyond the outermost knots the
curve is constant."));
end LearnedSpring;
