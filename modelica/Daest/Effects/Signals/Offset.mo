within Daest.Effects.Signals;
block Offset "Constant added to the signal"
  extends Interfaces.SignalEffect;
  parameter Real b = 0.1 "Offset"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "u"));
equation
  y = u + b;
  annotation(
    __Daest(effect = true, attach = "signal", outside = "output", law = "y = u + b"),
    Documentation(info = "A zero that was not adjusted."));
end Offset;
