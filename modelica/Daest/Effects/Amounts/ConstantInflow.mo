within Daest.Effects.Amounts;
model ConstantInflow "Constant inflow into a store"
  extends Interfaces.PartialStore;
  parameter Real r_0 = 0.01 "Rate at which the store gains"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "u/s"));
equation
  r = r_0;
  annotation(
    __Daest(effect = true, attach = "connector", law = "r = r_0"),
    Documentation(info = "A source that nobody has recorded: what the body makes itself, what comes in from outside.
Negative for what is taken out at a constant rate."));
end ConstantInflow;
