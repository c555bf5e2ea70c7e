within Daest.Effects.Rotational;
model LearnedSpring "Torque as a curve over the angle"
  extends Interfaces.PartialRelative;
  constant Integer n_knots = 9 "Number of knots";
  parameter SI.Torque y[n_knots] = zeros(n_knots) "Torque against the deflection at the knots"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Angle phi_max(min = 1e-12) = 1
    "Angle of the outermost knots, which lie at -phi_max and phi_max"
    annotation(__Daest(role = "shape", of = "phi", grid = {1}));
equation
  tau = -sum(
    y[k]*noEvent(max(0, 1 - abs(1 + (n_knots - 1)*(1 + max(-1, min(1, phi/phi_max)))/2 - k))) for k in 1:n_knots);
  annotation(
    __Daest(effect = true, attach = "connector", turns = 30,
      law = "tau = -curve(phi), straight lines between the knots from -phi_max to phi_max"),
    Documentation(info = "For an effect that no other class describes. Beyond the outermost knots the
curve is constant."));
end LearnedSpring;
