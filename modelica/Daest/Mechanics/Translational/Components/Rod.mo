within Daest.Mechanics.Translational.Components;
model Rod "Rigid body without mass"
  extends Interfaces.PartialRigid;
equation
  0 = flange_a.f + flange_b.f;
end Rod;
