within Daest.Mechanics.Rotational.Interfaces;
partial model PartialCompliantWithRelativeStates "Compliant connection of two flanges, with relative motion"
  extends PartialTwoFlanges;
  SI.Angle phi_rel(start = 0) "Relative angle (= flange_b.phi - flange_a.phi)";
  SI.AngularVelocity w_rel(start = 0) "Relative angular velocity (= der(phi_rel))";
  SI.AngularAcceleration a_rel "Relative angular acceleration (= der(w_rel))";
  SI.Torque tau "Torque between the flanges (= flange_b.tau)";
equation
  phi_rel = flange_b.phi - flange_a.phi;
  w_rel = der(phi_rel);
  a_rel = der(w_rel);
  flange_b.tau = tau;
  flange_a.tau = -tau;
end PartialCompliantWithRelativeStates;
