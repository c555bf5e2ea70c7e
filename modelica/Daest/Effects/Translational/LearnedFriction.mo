within Daest.Effects.Translational;
model LearnedFriction "Force as a curve over the velocity"
  extends Interfaces.PartialFriction;
  constant Integer n_knots = 9 "Number of knots";
  parameter SI.Force y[n_knots] = zeros(n_knots) "Force against the motion at the knots"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Velocity v_max(min = 1e-12) = 1
    "Velocity of the outermost knots, which lie at -v_max and v_max"
    annotation(__Daest(role = "shape", of = "v", grid = {1}));
equation
  f = -sum(
    y[k]*noEvent(max(0, 1 - abs(1 + (n_knots - 1)*(1 + max(-1, min(1, v/v_max)))/2 - k))) for k in 1:n_knots);
  annotation(
    __Daest(effect = true, attach = "connector",
      law = "f = -curve(v), straight lines between the knots from -v_max to v_max"),
    Documentation(info = "For an effect that no other class describes. Beyond the outermost knots the
curve is constant."));
end LearnedFriction;
