within Daest.Effects.Translational;
model ReturnSpring "Spring to the housing whose force goes with the displacement"
  extends Interfaces.PartialFlange;
  parameter SI.TranslationalSpringConstant c = 1000 "Stiffness, below zero where the force drives away"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Position s_0 = 0 "Position at which the spring is at rest"
    annotation(__Daest(estimate = true, role = "shape", of = "s", grid = {-0.3, 0, 0.3}));
equation
  f = -c*(s - s_0);
  annotation(
    __Daest(effect = true, attach = "connector", law = "f = -c*(s - s_0)"),
    Documentation(info = "What pulls a valve, a pedal or a cable back to its place. A body near a magnet, or on
top of an inverted pendulum, is driven away (c < 0)."));
end ReturnSpring;
