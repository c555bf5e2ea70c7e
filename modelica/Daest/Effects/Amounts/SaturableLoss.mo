within Daest.Effects.Amounts;
model SaturableLoss "Loss that saturates: the law of Michaelis and Menten"
  extends Interfaces.PartialStore;
  parameter Real r_max(min = 0) = 0.01 "Rate of the loss from a large amount"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "u/s"));
  parameter Real x_h(min = 1e-12) = 1 "Amount at which half of that is lost"
    annotation(__Daest(estimate = true, role = "shape", of = "x", grid = {0.05, 0.3}, unit = "u"));
equation
  r = -r_max*x/(x_h + abs(x));
  annotation(
    __Daest(effect = true, attach = "connector", law = "r = -r_max*x/(x_h + |x|)"),
    Documentation(info = "An enzyme, a transporter or microbes that take up no more than so much in a unit of time."));
end SaturableLoss;
