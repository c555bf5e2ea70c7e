within Daest.Mechanics.Translational.Interfaces;
partial model PartialRigid "Rigid connection of two flanges"
  extends PartialTwoFlanges;
  SI.Position s(start = 0) "Position of the centre (= flange_a.s + L/2 = flange_b.s - L/2)";
  parameter SI.Length L(start = 0) = 0 "Length from the left flange to the right one (= flange_b.s - flange_a.s)";
equation
  flange_a.s = s - L/2;
  flange_b.s = s + L/2;
end PartialRigid;
