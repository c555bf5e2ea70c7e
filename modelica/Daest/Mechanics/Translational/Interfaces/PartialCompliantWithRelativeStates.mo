within Daest.Mechanics.Translational.Interfaces;
partial model PartialCompliantWithRelativeStates "Compliant connection of two flanges, with relative motion"
  extends PartialTwoFlanges;
  SI.Position s_rel(start = 0) "Relative position (= flange_b.s - flange_a.s)";
  SI.Velocity v_rel(start = 0) "Relative velocity (= der(s_rel))";
  SI.Force f "Force between the flanges (= flange_b.f)";
equation
  s_rel = flange_b.s - flange_a.s;
  v_rel = der(s_rel);
  flange_b.f = f;
  flange_a.f = -f;
end PartialCompliantWithRelativeStates;
