within Daest.Effects.Translational;
model QuadraticDrag "Drag in proportion to the square of the velocity"
  extends Interfaces.PartialFriction;
  parameter Real k(unit = "N.s2/m2", min = 0) = 1 "Drag constant"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Velocity v_s(min = 1e-12) = 0.001 "Velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "v", grid = {0.01}));
equation
  f = -k*v*sqrt(v^2 + v_s^2);
  annotation(
    __Daest(effect = true, attach = "connector", outside = "input", law = "f = -k*v*sqrt(v^2 + v_s^2)"),
    Documentation(info = "Air and water at high velocity: fans, propellers, vehicles. The step of the
ideal law is rounded over v_s, which is not estimated: about 1 % of the range of the velocity."));
end QuadraticDrag;
