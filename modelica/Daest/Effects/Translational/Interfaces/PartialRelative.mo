within Daest.Effects.Translational.Interfaces;
partial model PartialRelative "Effect on a body, against the housing or another body"
  extends Daest.Mechanics.Translational.Interfaces.PartialElementaryOneFlangeAndSupport2;
  SI.Position s "Position of the flange with respect to the support (= flange.s - support.s)";
  SI.Force f "Force of the effect on the body (= -flange.f)";
equation
  s = flange.s - s_support;
  flange.f = -f;
end PartialRelative;
