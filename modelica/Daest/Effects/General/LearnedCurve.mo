within Daest.Effects.General;
block LearnedCurve "Curve over the signal, added to it"
  extends Daest.Effects.Signals.Interfaces.SignalEffect;
  constant Integer n_knots = 9 "Number of knots";
  parameter Real c[n_knots] = zeros(n_knots) "What is added to the signal at the knots"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "u"));
  parameter Real u_max(min = 1e-12) = 1 "Signal at the outermost knots, which lie at -u_max and u_max"
    annotation(__Daest(role = "shape", of = "u", grid = {1}, unit = "u"));
equation
  y = u + sum(
    c[k]*noEvent(max(0, 1 - abs(1 + (n_knots - 1)*(1 + max(-1, min(1, u/u_max)))/2 - k))) for k in 1:n_knots);
  annotation(
    __Daest(effect = true, attach = "signal",
      law = "y = u + curve(u), straight lines between the knots from -u_max to u_max"),
    Documentation(info = "For an effect that no other class describes. Beyond the outermost knots the
curve is constant."));
end LearnedCurve;
