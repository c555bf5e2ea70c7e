within Daest.Effects.Translational;
model ConstantLoad "Constant force against the positive direction"
  extends Interfaces.PartialFlange;
  parameter SI.Force f_0 = 1 "Load force, positive against the positive direction"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  f = -f_0;
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "f = -f_0"),
    Documentation(info = "A weight, a preload, or the offset of an amplifier."));
end ConstantLoad;
