within Daest.Effects.Hydraulic;
model ConstantHead "Pressure that is lost whatever the flow, such as a height that the model lacks"
  extends Daest.Hydraulic.Interfaces.PartialLine;
  parameter Real dp_0(unit = "Pa") = 1e4 "Pressure drop, negative where pressure is added"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  dp = dp_0;
  annotation(
    __Daest(effect = true, attach = "series", law = "dp = dp_0"),
    Documentation(info = "A line that ends higher than the model says, a valve that opens against a spring, a static
head beside that of a pump."));
end ConstantHead;
