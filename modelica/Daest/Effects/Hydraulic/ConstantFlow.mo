within Daest.Effects.Hydraulic;
model ConstantFlow "Constant flow into the system"
  extends Interfaces.PartialPort;
  parameter Real q_0(unit = "m3/s") = 1e-6 "Flow"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  q = q_0;
  annotation(
    __Daest(effect = true, attach = "connector", law = "q = q_0"),
    Documentation(info = "A constant flow that nobody has measured: a pump, or air that a vacuum draws in through a leak at
the speed of sound. Negative out of the system."));
end ConstantFlow;
