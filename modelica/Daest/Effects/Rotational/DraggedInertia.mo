within Daest.Effects.Rotational;
model DraggedInertia "Inertia that a film, a fluid or eddy currents drag along with a shaft"
  extends Interfaces.PartialFlange;
  parameter SI.Inertia J(min = 0) = 1e-4 "Moment of inertia that is dragged along"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-9) = 0.1 "Time constant of the drag: J over its damping"
    annotation(__Daest(estimate = true, role = "shape", of = "time", grid = {0.001, 0.003, 0.01, 0.03, 0.1}));
  SI.AngularVelocity r(start = 0, stateSelect = StateSelect.prefer)
    "Angular velocity of the inertia with respect to the shaft";
  SI.AngularVelocity w "Angular velocity (= der(phi))";
equation
  w = der(phi);
  der(r) = -r/T - der(w);
  tau = J*r/T;
  annotation(
    __Daest(effect = true, attach = "connector", law = "der(r) = -r/T - der(w), tau = J*r/T"),
    Documentation(info = "Liquids in drums, loose rotors and slipping couplings follow a shaft without a
spring. The damping is J/T; at the start the inertia moves with the shaft."));
end DraggedInertia;
