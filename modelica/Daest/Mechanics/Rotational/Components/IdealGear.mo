within Daest.Mechanics.Rotational.Components;
model IdealGear "Gear without inertia and loss"
  extends Interfaces.PartialElementaryTwoFlangesAndSupport2;
  parameter Real ratio(unit = "1", start = 1) "Transmission ratio (flange_a.phi/flange_b.phi)";
  SI.Angle phi_a "Angle of the left flange with respect to the support (= flange_a.phi - support.phi)";
  SI.Angle phi_b "Angle of the right flange with respect to the support (= flange_b.phi - support.phi)";
equation
  phi_a = flange_a.phi - phi_support;
  phi_b = flange_b.phi - phi_support;
  phi_a = ratio*phi_b;
  0 = ratio*flange_a.tau + flange_b.tau;
end IdealGear;
