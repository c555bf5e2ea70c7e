within Daest.Effects.Rotational;
model QuadraticDrag "Drag in proportion to the square of the angular velocity"
  extends Interfaces.PartialFriction;
  parameter Real k(unit = "N.m.s2/rad2", min = 0) = 1e-4 "Drag constant"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.AngularVelocity w_s(min = 1e-12) = 0.01 "Angular velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "w", grid = {0.01}));
equation
  tau = -k*w*sqrt(w^2 + w_s^2);
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "tau = -k*w*sqrt(w^2 + w_s^2)"),
    Documentation(info = "Air and water at high angular velocity: fans, propellers, vehicles. The step
of the ideal law is rounded over w_s, which is not estimated: about 1 % of the range of the angular
velocity."));
end QuadraticDrag;
