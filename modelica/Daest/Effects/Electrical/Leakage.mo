within Daest.Effects.Electrical;
model Leakage "Current past an insulation"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter SI.Conductance G(min = 0) = 1e-3 "Conductance of the leak"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  i = G*v;
  annotation(
    __Daest(effect = true, attach = "parallel", law = "i = G*v"),
    Documentation(info = "Moisture, dirt, a damaged insulation, the resistance of a voltmeter."));
end Leakage;
