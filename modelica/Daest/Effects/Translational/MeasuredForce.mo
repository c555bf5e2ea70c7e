within Daest.Effects.Translational;
model MeasuredForce "Force in proportion to a measured signal"
  extends Interfaces.PartialFlange;
  Daest.Blocks.Interfaces.RealInput u "Measured signal";
  parameter Real k = 0.01 "Force per unit of the signal"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  f = k*u;
  annotation(
    __Daest(effect = true, attach = "connector", inputs = {"u"}, law = "f = k*u"),
    Documentation(info = "A recorded signal that the model has not used so far drives the body."));
end MeasuredForce;
