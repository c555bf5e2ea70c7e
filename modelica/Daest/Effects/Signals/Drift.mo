within Daest.Effects.Signals;
block Drift "Zero that drifts with time"
  extends Interfaces.SignalEffect;
  parameter Real r = 1e-3 "Drift per second"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "u/s"));
equation
  y = u + r*time;
  annotation(
    __Daest(effect = true, attach = "signal", outside = "output", law = "y = u + r*time"),
    Documentation(info = "Integrators, strain gauges, warm-up."));
end Drift;
