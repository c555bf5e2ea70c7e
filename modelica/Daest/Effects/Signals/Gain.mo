within Daest.Effects.Signals;
block Gain "Wrong scale of the signal"
  extends Interfaces.SignalEffect;
  parameter Real g(unit = "1", min = -1) = 0.1 "Share by which the signal is too large"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  y = (1 + g)*u;
  annotation(
    __Daest(effect = true, attach = "signal", outside = "output", law = "y = (1 + g)*u"),
    Documentation(info = "A calibration that is off by the share g."));
end Gain;
