within Daest.Effects.Translational;
model AsymmetricDamper "Damping in one direction only"
  extends Interfaces.PartialFriction;
  parameter SI.TranslationalDampingConstant d(min = 0) = 1 "Damping constant in the direction that damps"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real direction(unit = "1", min = -1, max = 1) = 1
    "Direction that damps: 1 for positive velocity, -1 for negative"
    annotation(__Daest(role = "shape", grid = {1, -1}));
  parameter SI.Velocity v_s(min = 1e-12) = 0.001 "Velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "v", grid = {0.01}));
equation
  f = -d*v*(1 + direction*tanh(v/v_s))/2;
  annotation(
    __Daest(effect = true, attach = "connector", one_way = "ViscousFriction",
      law = "f = -d*v*(1 + direction*tanh(v/v_s))/2"),
    Documentation(info = "Together with a damper it gives damping of two sizes, as shock absorbers
have it for bump and rebound. The step of the ideal law is rounded over v_s, which is not estimated: about 1
% of the range of the velocity."));
end AsymmetricDamper;
