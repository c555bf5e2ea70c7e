within Daest.Effects.Rotational;
model Unbalance "Weight off the axis: a pendulum's torque"
  extends Interfaces.PartialFlange;
  parameter SI.Torque mgr(min = 0) = 0.1 "Mass times gravity times distance from the axis"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Angle phi_0(min = -7, max = 7) = 0 "Angle of the weight above its lowest point at phi = 0"
    annotation(__Daest(estimate = true, role = "shape",
      grid = {-2.356, -1.571, -0.785, 0, 0.785, 1.571, 2.356, 3.142}));
equation
  tau = -mgr*sin(phi + phi_0);
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "tau = -mgr*sin(phi + phi_0)"),
    Documentation(info = "Arms, doors and unbalanced discs. The torque is conservative."));
end Unbalance;
