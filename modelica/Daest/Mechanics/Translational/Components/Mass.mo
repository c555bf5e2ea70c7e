within Daest.Mechanics.Translational.Components;
model Mass "Sliding body with mass"
  extends Interfaces.PartialRigid(s(start = 0, stateSelect = StateSelect.prefer));
  parameter SI.Mass m(min = 0, start = 1) "Mass";
  SI.Velocity v(start = 0, stateSelect = StateSelect.prefer) "Absolute velocity (= der(s))";
  SI.Acceleration a "Absolute acceleration (= der(v))";
equation
  v = der(s);
  a = der(v);
  m*a = flange_a.f + flange_b.f;
end Mass;
