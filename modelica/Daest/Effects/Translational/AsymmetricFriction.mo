within Daest.Effects.Translational;
model AsymmetricFriction "Dry friction in one direction only"
  extends Interfaces.PartialFriction;
  parameter SI.Force f_d(min = 0) = 1 "Friction force in the direction that rubs"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real direction(unit = "1", min = -1, max = 1) = 1
    "Direction that rubs: 1 for positive velocity, -1 for negative"
    annotation(__Daest(role = "shape", grid = {1, -1}));
  parameter SI.Velocity v_s(min = 1e-12) = 0.001 "Velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "v", grid = {0.01}));
equation
  f = -f_d*tanh(v/v_s)*(1 + direction*tanh(v/v_s))/2;
  annotation(
    __Daest(effect = true, attach = "connector", sum_of = {"CoulombFriction", "ConstantLoad"},
      law = "f = -f_d*tanh(v/v_s)*(1 + direction*tanh(v/v_s))/2"),
    Documentation(info = "Together with Coulomb friction it gives friction of two sizes, one for each
direction, as guides and belts have it that are loaded to one side. The step of the ideal law is rounded
over v_s, which is not estimated: about 1 % of the range of the velocity."));
end AsymmetricFriction;
