within Daest.Effects.Amounts;
model QuadraticLoss "Loss by the square of the amount"
  extends Interfaces.PartialStore;
  parameter Real k(min = 0) = 0.01 "Share that is lost in a unit of time, per amount"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "1/(u.s)"));
equation
  r = -k*x*abs(x);
  annotation(
    __Daest(effect = true, attach = "connector", law = "r = -k*x*|x|"),
    Documentation(info = "What two of a kind do together: a reaction of the second order, particles that clot, a
population in its own way, which then grows to a limit."));
end QuadraticLoss;
