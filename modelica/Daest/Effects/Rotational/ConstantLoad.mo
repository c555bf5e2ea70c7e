within Daest.Effects.Rotational;
model ConstantLoad "Constant torque against the positive direction"
  extends Interfaces.PartialFlange;
  parameter SI.Torque tau_0 = 0.01 "Load torque, positive against the positive direction"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  tau = -tau_0;
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "tau = -tau_0"),
    Documentation(info = "A weight, a preload, or the offset of an amplifier."));
end ConstantLoad;
