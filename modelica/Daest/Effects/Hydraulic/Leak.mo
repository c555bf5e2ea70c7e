within Daest.Effects.Hydraulic;
model Leak "Flow out of the system in proportion to the pressure"
  extends Interfaces.PartialPort;
  parameter Real G(unit = "m3/(s.Pa)", min = 0) = 1e-8 "Flow per pressure"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  q = -G*p;
  annotation(
    __Daest(effect = true, attach = "connector", law = "q = -G*p"),
    Documentation(info = "A seal or a hole that loses liquid to the ambient."));
end Leak;
