within Daest.Effects.Rotational;
model ReturnSpring "Spring to the housing whose torque goes with the angle"
  extends Interfaces.PartialFlange;
  parameter SI.RotationalSpringConstant c = 1 "Stiffness, below zero where the torque drives away"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Angle phi_0 = 0 "Angle at which the spring is at rest"
    annotation(__Daest(estimate = true, role = "shape", of = "phi", grid = {-0.3, 0, 0.3}));
equation
  tau = -c*(phi - phi_0);
  annotation(
    __Daest(effect = true, attach = "connector", turns = 30, law = "tau = -c*(phi - phi_0)"),
    Documentation(info = "What pulls a valve, a pedal or a cable back to its place; gravity at small
angles. A body that stands upright, or is near a magnet, is driven away (c < 0)."));
end ReturnSpring;
