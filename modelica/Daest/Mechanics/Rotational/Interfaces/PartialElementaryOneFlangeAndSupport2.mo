within Daest.Mechanics.Rotational.Interfaces;
partial model PartialElementaryOneFlangeAndSupport2 "Component with one flange and a housing"
  parameter Boolean useSupport = false "= true, if the support flange is enabled, otherwise it is fixed"
    annotation(Evaluate = true);
  Flange_b flange "Flange of the shaft";
  Support support(phi = phi_support, tau = -flange.tau) if useSupport "Support of the housing";
protected
  SI.Angle phi_support "Absolute angle of the support";
equation
  if not useSupport then
    phi_support = 0;
  end if;
end PartialElementaryOneFlangeAndSupport2;
