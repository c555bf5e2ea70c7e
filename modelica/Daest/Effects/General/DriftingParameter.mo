within Daest.Effects.General;
block DriftingParameter "Parameter that changes with time"
  extends Daest.Effects.Signals.Interfaces.SignalEffect;
  parameter Real r(unit = "1/s") = 1e-3 "Change per second, as a share of the value at time 0"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  y = u*(1 + r*time);
  annotation(
    __Daest(effect = true, attach = "parameter", law = "y = u*(1 + r*time)"),
    Documentation(info = "Wear, warm-up, fouling. The parameter itself becomes the value at time 0."));
end DriftingParameter;
