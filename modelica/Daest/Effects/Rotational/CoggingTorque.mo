within Daest.Effects.Rotational;
model CoggingTorque "Torque that repeats several times in a turn"
  extends Interfaces.PartialFlange;
  parameter SI.Torque tau_k(min = 0) = 0.001 "Amplitude of the torque"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real n(unit = "1", min = 0) = 12 "Number of periods in a turn"
    annotation(__Daest(role = "shape", periods = "phi", grid = {2, 3, 4, 6, 8, 12}));
  parameter SI.Angle phi_0(min = -7, max = 7) = 0 "Phase of the torque at phi = 0"
    annotation(__Daest(estimate = true, role = "shape", grid = {0, 1.571, 3.142, 4.712}));
equation
  tau = -tau_k*sin(n*phi + phi_0);
  annotation(
    __Daest(effect = true, attach = "connector", law = "tau = -tau_k*sin(n*phi + phi_0)"),
    Documentation(info = "Magnets over slots, gear teeth. The torque is conservative. One period in a
turn is the torque of a weight off the axis (Unbalance)."));
end CoggingTorque;
