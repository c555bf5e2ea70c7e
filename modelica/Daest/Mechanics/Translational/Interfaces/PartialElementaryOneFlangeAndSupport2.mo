within Daest.Mechanics.Translational.Interfaces;
partial model PartialElementaryOneFlangeAndSupport2 "Component with one flange and a housing"
  parameter Boolean useSupport = false "= true, if the support flange is enabled, otherwise it is fixed"
    annotation(Evaluate = true);
  Flange_b flange "Flange of the slider";
  Support support(s = s_support, f = -flange.f) if useSupport "Support of the housing";
protected
  SI.Position s_support "Absolute position of the support";
equation
  if not useSupport then
    s_support = 0;
  end if;
end PartialElementaryOneFlangeAndSupport2;
