within Daest.Mechanics.Rotational.Interfaces;
partial model PartialElementaryTwoFlangesAndSupport2 "Component with two flanges and a housing"
  extends PartialTwoFlanges;
  parameter Boolean useSupport = false "= true, if the support flange is enabled, otherwise it is fixed"
    annotation(Evaluate = true);
  Support support(phi = phi_support, tau = -flange_a.tau - flange_b.tau) if useSupport
    "Support of the housing";
protected
  SI.Angle phi_support "Absolute angle of the support";
equation
  if not useSupport then
    phi_support = 0;
  end if;
end PartialElementaryTwoFlangesAndSupport2;
