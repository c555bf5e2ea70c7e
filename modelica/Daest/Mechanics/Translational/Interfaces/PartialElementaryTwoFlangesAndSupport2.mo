within Daest.Mechanics.Translational.Interfaces;
partial model PartialElementaryTwoFlangesAndSupport2 "Component with two flanges and a housing"
  extends PartialTwoFlanges;
  parameter Boolean useSupport = false "= true, if the support flange is enabled, otherwise it is fixed"
    annotation(Evaluate = true);
  Support support(s = s_support, f = -flange_a.f - flange_b.f) if useSupport
    "Support of the housing";
protected
  SI.Position s_support "Absolute position of the support";
equation
  if not useSupport then
    s_support = 0;
  end if;
end PartialElementaryTwoFlangesAndSupport2;
