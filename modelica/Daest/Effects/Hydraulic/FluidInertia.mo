within Daest.Effects.Hydraulic;
model FluidInertia "Inertia of the liquid in a line, which was left out"
  extends Daest.Hydraulic.Interfaces.PartialLine;
  parameter Real L(unit = "Pa.s2/m3", min = 0) = 1e6 "Pressure drop per change of the flow over time"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  dp = L*der(q);
  annotation(
    __Daest(effect = true, attach = "series", dynamic = true, law = "dp = L*der(q)"),
    Documentation(info = "A long column of liquid is slow to start and to stop: it swings between two vessels, and
hammers at a valve that shuts. L is the density times the length over the cross-section of the line."));
end FluidInertia;
