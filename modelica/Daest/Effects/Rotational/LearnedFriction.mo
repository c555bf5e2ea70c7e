within Daest.Effects.Rotational;
model LearnedFriction "Torque as a curve over the angular velocity"
  extends Interfaces.PartialFriction;
  constant Integer n_knots = 9 "Number of knots";
  parameter SI.Torque y[n_knots] = zeros(n_knots) "Torque against the motion at the knots"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.AngularVelocity w_max(min = 1e-12) = 1
    "Angular velocity of the outermost knots, which lie at -w_max and w_max"
    annotation(__Daest(role = "shape", of = "w", grid = {1}));
equation
  tau = -sum(
    y[k]*noEvent(max(0, 1 - abs(1 + (n_knots - 1)*(1 + max(-1, min(1, w/w_max)))/2 - k))) for k in 1:n_knots);
  annotation(
    __Daest(effect = true, attach = "connector",
      law = "tau = -curve(w), straight lines between the knots from -w_max to w_max"),
    Documentation(info = "For an effect that no other class describes. Beyond the outermost knots the
curve is constant."));
end LearnedFriction;
