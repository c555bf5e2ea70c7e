within Daest.Effects.Rotational;
model AsymmetricFriction "Dry friction in one direction only"
  extends Interfaces.PartialFriction;
  parameter SI.Torque tau_d(min = 0) = 0.01 "Friction torque in the direction that rubs"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real direction(unit = "1", min = -1, max = 1) = 1
    "Direction that rubs: 1 for positive angular velocity, -1 for negative"
    annotation(__Daest(role = "shape", grid = {1, -1}));
  parameter SI.AngularVelocity w_s(min = 1e-12) = 0.01 "Angular velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "w", grid = {0.01}));
equation
  tau = -tau_d*tanh(w/w_s)*(1 + direction*tanh(w/w_s))/2;
  annotation(
    __Daest(effect = true, attach = "connector", sum_of = {"CoulombFriction", "ConstantLoad"},
      law = "tau = -tau_d*tanh(w/w_s)*(1 + direction*tanh(w/w_s))/2"),
    Documentation(info = "Together with Coulomb friction it gives friction of two sizes, one for each
direction, as guides and belts have it that are loaded to one side. The step of the ideal law is rounded
over w_s, which is not estimated: about 1 % of the range of the angular velocity."));
end AsymmetricFriction;
