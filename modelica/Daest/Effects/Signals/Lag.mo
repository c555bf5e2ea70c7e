within Daest.Effects.Signals;
block Lag "First-order lag"
  extends Interfaces.SignalEffect;
  parameter SI.Time T(min = 0) = 0.01 "Time constant"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  T*der(y) = u - y;
  annotation(
    __Daest(effect = true, attach = "signal", outside = "output", dynamic = true, law = "T*der(y) = u - y"),
    Documentation(info = "Amplifiers, filters and sensors that follow with a delay."));
end Lag;
