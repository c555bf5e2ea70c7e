within Daest.Effects.Hydraulic;
model LaminarLine "Laminar flow from one vessel to the next"
  extends Daest.Hydraulic.Interfaces.PartialLine;
  parameter Real G(unit = "m3/(s.Pa)", min = 0) = 1e-8 "Flow per pressure drop"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  q = G*dp;
  annotation(
    __Daest(effect = true, attach = "parallel", law = "q = G*dp"),
    Documentation(info = "What leaks past the seal of a piston from one chamber of a cylinder to the other."));
end LaminarLine;
