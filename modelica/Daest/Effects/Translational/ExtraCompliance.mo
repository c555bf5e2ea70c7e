within Daest.Effects.Translational;
model ExtraCompliance "Elasticity between two bodys that were taken as rigid"
  extends Daest.Mechanics.Translational.Interfaces.PartialCompliant;
  parameter Real e(unit = "m/N", min = 0) = 1e-5 "Compliance: deflection per force"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 0) = 1e-3 "Relaxation time: damping over stiffness"
    annotation(__Daest(estimate = true, role = "shape", grid = {1e-4, 1e-3, 1e-2}));
  SI.Velocity v_rel "Relative velocity (= der(s_rel))";
equation
  v_rel = der(s_rel);
  s_rel + T*v_rel = e*f;
  annotation(
    __Daest(effect = true, attach = "series", dynamic = true, law = "s_rel + T*der(s_rel) = e*f"),
    Documentation(info = "Couplings, belts and long bodys give way a little. e = 0 is a rigid
connection."));
end ExtraCompliance;
