within Daest.Effects.Amounts;
model FirstOrderLoss "Loss in proportion to the amount"
  extends Interfaces.PartialStore;
  parameter Real k(unit = "1/s", min = 0) = 0.01 "Share that is lost in a unit of time"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  r = -k*x;
  annotation(
    __Daest(effect = true, attach = "connector", law = "r = -k*x"),
    Documentation(info = "Decay, a further way of clearance, death, a leak. Where the model has a loss of that form
whose rate is estimated, it is a part of that."));
end FirstOrderLoss;
