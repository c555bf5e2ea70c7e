within Daest.Effects.Rotational;
model ExtraCompliance "Elasticity between two shafts that were taken as rigid"
  extends Daest.Mechanics.Rotational.Interfaces.PartialCompliant;
  parameter Real e(unit = "rad/(N.m)", min = 0) = 0.01 "Compliance: deflection per torque"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 0) = 1e-3 "Relaxation time: damping over stiffness"
    annotation(__Daest(estimate = true, role = "shape", grid = {1e-4, 1e-3, 1e-2}));
  SI.AngularVelocity w_rel "Relative angular velocity (= der(phi_rel))";
equation
  w_rel = der(phi_rel);
  phi_rel + T*w_rel = e*tau;
  annotation(
    __Daest(effect = true, attach = "series", dynamic = true, law = "phi_rel + T*der(phi_rel) = e*tau"),
    Documentation(info = "Couplings, belts and long shafts give way a little. e = 0 is a rigid
connection."));
end ExtraCompliance;
