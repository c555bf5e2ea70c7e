within Daest.Mechanics.Translational.Components;
model Fixed "Flange fixed in the housing at a given position"
  parameter SI.Position s0 = 0 "Fixed position of the flange";
  Interfaces.Flange_b flange "Flange that is held";
equation
  flange.s = s0;
end Fixed;
