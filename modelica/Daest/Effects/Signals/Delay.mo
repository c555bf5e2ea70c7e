within Daest.Effects.Signals;
block Delay "Dead time"
  extends Interfaces.SignalEffect;
  parameter SI.Time T(min = 0) = 0.01 "Dead time"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  y = delay(u, T);
  annotation(
    __Daest(effect = true, attach = "signal", dynamic = true, law = "y(t) = u(t - T)"),
    Documentation(info = "Sampling, buses and transport. What u was over the last T seconds is kept by ten linear
equations: a sine is late to 1e-4 up to T*omega = 10, a step rings by a tenth."));
end Delay;
