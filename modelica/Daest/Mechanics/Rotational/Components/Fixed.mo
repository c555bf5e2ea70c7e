within Daest.Mechanics.Rotational.Components;
model Fixed "Flange fixed in the housing at a given angle"
  parameter SI.Angle phi0 = 0 "Fixed angle of the flange";
  Interfaces.Flange_b flange "Flange that is held";
equation
  flange.phi = phi0;
end Fixed;
