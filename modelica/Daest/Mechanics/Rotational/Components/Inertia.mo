within Daest.Mechanics.Rotational.Components;
model Inertia "Rotating body with inertia"
  extends Interfaces.PartialTwoFlanges;
  parameter SI.Inertia J(min = 0, start = 1) "Moment of inertia";
  SI.Angle phi(start = 0, stateSelect = StateSelect.prefer) "Absolute angle of the body (= flange_a.phi)";
  SI.AngularVelocity w(start = 0, stateSelect = StateSelect.prefer) "Absolute angular velocity (= der(phi))";
  SI.AngularAcceleration a "Absolute angular acceleration (= der(w))";
equation
  phi = flange_a.phi;
  phi = flange_b.phi;
  w = der(phi);
  a = der(w);
  J*a = flange_a.tau + flange_b.tau;
end Inertia;
