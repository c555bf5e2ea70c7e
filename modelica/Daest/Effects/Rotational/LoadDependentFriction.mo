within Daest.Effects.Rotational;
model LoadDependentFriction "Dry friction in proportion to the torque that is transmitted"
  extends Daest.Mechanics.Rotational.Interfaces.PartialTwoFlanges;
  parameter Real mu(unit = "1", min = 0, max = 1) = 0.05 "Friction torque over transmitted torque"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.AngularVelocity w_s(min = 1e-12) = 0.01 "Angular velocity over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "w", grid = {0.01}));
  parameter SI.Torque tau_s(min = 1e-12) = 1e-4 "Torque over which the load changes sign"
    annotation(__Daest(role = "sharpness", of = "load", grid = {0.01}));
  SI.Angle phi "Angle of both flanges";
  SI.AngularVelocity w "Angular velocity (= der(phi))";
  SI.Torque load "Torque transmitted from flange_a to flange_b";
  SI.Torque tau "Friction torque on the shaft";
equation
  phi = flange_a.phi;
  phi = flange_b.phi;
  w = der(phi);
  load = (flange_a.tau - flange_b.tau)/2;
  tau = -mu*load*tanh(load/tau_s)*tanh(w/w_s);
  flange_a.tau + flange_b.tau + tau = 0;
  annotation(
    __Daest(effect = true, attach = "series", law = "tau = -mu*|load|*tanh(w/w_s)"),
    Documentation(info = "Gears and worm drives rub the more the harder they are loaded. |load| is
rounded as load*tanh(load/tau_s). The step of the ideal law is rounded over w_s, which is not estimated:
about 1 % of the range of the angular velocity."));
end LoadDependentFriction;
