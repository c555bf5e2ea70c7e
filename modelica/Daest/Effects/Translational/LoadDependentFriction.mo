within Daest.Effects.Translational;
model LoadDependentFriction "Dry friction in proportion to the force that is transmitted"
  extends Daest.Mechanics.Translational.Interfaces.PartialTwoFlanges;
  parameter Real mu(unit = "1", min = 0, max = 1) = 0.05 "Friction force over transmitted force"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Velocity v_s(min = 1e-12) = 0.001 "Velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "v", grid = {0.01}));
  parameter SI.Force f_s(min = 1e-12) = 1e-2 "Force over which the load changes sign"
    annotation(__Daest(role = "sharpness", of = "load", grid = {0.01}));
  SI.Position s "Position of both flanges";
  SI.Velocity v "Velocity (= der(s))";
  SI.Force load "Force transmitted from flange_a to flange_b";
  SI.Force f "Friction force on the body";
equation
  s = flange_a.s;
  s = flange_b.s;
  v = der(s);
  load = (flange_a.f - flange_b.f)/2;
  f = -mu*load*tanh(load/f_s)*tanh(v/v_s);
  flange_a.f + flange_b.f + f = 0;
  annotation(
    __Daest(effect = true, attach = "series", law = "f = -mu*|load|*tanh(v/v_s)"),
    Documentation(info = "Gears and worm drives rub the more the harder they are loaded. |load| is
rounded as load*tanh(load/f_s). The step of the ideal law is rounded over v_s, which is not estimated: about
1 % of the range of the velocity."));
end LoadDependentFriction;
