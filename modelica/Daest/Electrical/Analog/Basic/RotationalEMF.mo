within Daest.Electrical.Analog.Basic;
model RotationalEMF "Converter between electrical and rotational power, without loss"
  extends Interfaces.OnePort;
  parameter Boolean useSupport = false "= true, if the support flange is enabled, otherwise it is fixed"
    annotation(Evaluate = true);
  parameter SI.ElectricalTorqueConstant k(start = 1) "Torque over current, and voltage over speed";
  SI.Angle phi(start = 0) "Angle of the flange with respect to the support (= flange.phi - support.phi)";
  SI.AngularVelocity w(start = 0) "Speed of the flange with respect to the support (= der(phi))";
  Daest.Mechanics.Rotational.Interfaces.Flange_b flange "Flange of the shaft";
  Daest.Mechanics.Rotational.Interfaces.Support support(phi = phi_support, tau = -flange.tau) if useSupport
    "Support of the housing";
protected
  SI.Angle phi_support "Absolute angle of the support";
equation
  if not useSupport then
    phi_support = 0;
  end if;
  phi = flange.phi - phi_support;
  w = der(phi);
  k*w = v;
  flange.tau = -k*i;
end RotationalEMF;
