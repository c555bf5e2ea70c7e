within Daest.Effects.General;
block MeasuredInput "Measured signal added to another one"
  extends Daest.Effects.Signals.Interfaces.SignalEffect;
  Daest.Blocks.Interfaces.RealInput z "Measured signal";
  parameter Real k = 0.1 "Share of the measured signal"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  y = u + k*z;
  annotation(
    __Daest(effect = true, attach = "signal", outside = "input", inputs = {"z"}, law = "y = u + k*z"),
    Documentation(info = "A recorded signal that the model has not used so far acts where another one
does."));
end MeasuredInput;
