within Daest.Effects.Rotational;
model ExtraInertia "Additional moment of inertia"
  extends Interfaces.PartialFlange;
  parameter SI.Inertia J(min = 0) = 1e-4 "Additional moment of inertia"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  SI.AngularVelocity w "Angular velocity (= der(phi))";
  SI.AngularAcceleration a "Acceleration (= der(w))";
equation
  w = der(phi);
  a = der(w);
  tau = -J*a;
  annotation(
    __Daest(effect = true, attach = "connector", dynamic = true, law = "tau = -J*der(w)"),
    Documentation(info = "Couplings, cables and payloads that nobody weighed."));
end ExtraInertia;
