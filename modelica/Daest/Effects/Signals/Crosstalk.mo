within Daest.Effects.Signals;
block Crosstalk "Share of an input that a sensor sees besides"
  extends Interfaces.SignalEffect;
  Daest.Blocks.Interfaces.RealInput z "Input that the sensor should not see";
  parameter Real k = 0.1 "Share of the input"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  y = u + k*z;
  annotation(
    __Daest(effect = true, attach = "output", inputs = {"z"}, driving = true, law = "y = u + k*z"),
    Documentation(info = "A sensor that answers to a second quantity, as a force sensor does to a force across it,
where that is an input of the model."));
end Crosstalk;
