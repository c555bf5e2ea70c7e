within Daest.Effects.Rotational;
model AsymmetricDamper "Damping in one direction only"
  extends Interfaces.PartialFriction;
  parameter SI.RotationalDampingConstant d(min = 0) = 0.001 "Damping constant in the direction that damps"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real direction(unit = "1", min = -1, max = 1) = 1
    "Direction that damps: 1 for positive angular velocity, -1 for negative"
    annotation(__Daest(role = "shape", grid = {1, -1}));
  parameter SI.AngularVelocity w_s(min = 1e-12) = 0.01 "Angular velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "w", grid = {0.01}));
equation
  tau = -d*w*(1 + direction*tanh(w/w_s))/2;
  annotation(
    __Daest(effect = true, attach = "connector", one_way = "ViscousFriction",
      law = "tau = -d*w*(1 + direction*tanh(w/w_s))/2"),
    Documentation(info = "Together with a damper it gives damping of two sizes, as shock absorbers
have it for bump and rebound. The step of the ideal law is rounded over w_s, which is not estimated: about 1
% of the range of the angular velocity."));
end AsymmetricDamper;
