within Daest.Electrical.Analog.Basic;
model TranslationalEMF "Converter between electrical and translational power, without loss"
  extends Interfaces.OnePort;
  parameter Boolean useSupport = false "= true, if the support flange is enabled, otherwise it is fixed"
    annotation(Evaluate = true);
  parameter SI.ElectricalForceConstant k(start = 1) "Force over current, and voltage over velocity";
  SI.Position s(start = 0) "Position of the flange with respect to the support (= flange.s - support.s)";
  SI.Velocity vel(start = 0) "Velocity of the flange with respect to the support (= der(s))";
  Daest.Mechanics.Translational.Interfaces.Flange_b flange "Flange of the slider";
  Daest.Mechanics.Translational.Interfaces.Support support(s = s_support, f = -flange.f) if useSupport
    "Support of the housing";
protected
  SI.Position s_support "Absolute position of the support";
equation
  if not useSupport then
    s_support = 0;
  end if;
  s = flange.s - s_support;
  vel = der(s);
  k*vel = v;
  flange.f = -k*i;
end TranslationalEMF;
