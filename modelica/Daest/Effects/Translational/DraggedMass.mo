within Daest.Effects.Translational;
model DraggedMass "Mass that a film, a fluid or eddy currents drag along with a body"
  extends Interfaces.PartialFlange;
  parameter SI.Mass m(min = 0) = 0.1 "Mass that is dragged along"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-9) = 0.1 "Time constant of the drag: m over its damping"
    annotation(__Daest(estimate = true, role = "shape", of = "time", grid = {0.001, 0.003, 0.01, 0.03, 0.1}));
  SI.Velocity r(start = 0, stateSelect = StateSelect.prefer)
    "Velocity of the mass with respect to the body";
  SI.Velocity v "Velocity (= der(s))";
equation
  v = der(s);
  der(r) = -r/T - der(v);
  f = m*r/T;
  annotation(
    __Daest(effect = true, attach = "connector", law = "der(r) = -r/T - der(v), f = m*r/T"),
    Documentation(info = "Liquids in tanks, loads in grease and slipping clamps follow a body without a
spring. The damping is m/T; at the start the mass moves with the body."));
end DraggedMass;
