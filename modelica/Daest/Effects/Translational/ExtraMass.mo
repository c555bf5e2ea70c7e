within Daest.Effects.Translational;
model ExtraMass "Additional mass"
  extends Interfaces.PartialFlange;
  parameter SI.Mass m(min = 0) = 0.1 "Additional mass"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  SI.Velocity v "Velocity (= der(s))";
  SI.Acceleration a "Acceleration (= der(v))";
equation
  v = der(s);
  a = der(v);
  f = -m*a;
  annotation(
    __Daest(effect = true, attach = "connector", dynamic = true, law = "f = -m*der(v)"),
    Documentation(info = "Couplings, cables and payloads that nobody weighed."));
end ExtraMass;
