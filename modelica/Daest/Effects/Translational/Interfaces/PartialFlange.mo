within Daest.Effects.Translational.Interfaces;
partial model PartialFlange "Effect on a body, against the housing"
  Daest.Mechanics.Translational.Interfaces.Flange_b flange "Flange of the body";
  SI.Position s "Position of the flange (= flange.s)";
  SI.Force f "Force of the effect on the body (= -flange.f)";
equation
  s = flange.s;
  flange.f = -f;
end PartialFlange;
