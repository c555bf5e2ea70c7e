within Daest.Effects.Electrical;
model Inductance "Inductance of a winding that was left out"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter SI.Inductance L(min = 0) = 1e-3 "Inductance"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  v = L*der(i);
  annotation(
    __Daest(effect = true, attach = "series", dynamic = true, law = "v = L*der(i)"),
    Documentation(info = "The current of a winding follows its voltage with the time constant L/R."));
end Inductance;
