within Daest.Effects.Rotational;
model FlexibleAppendage "Inertia that hangs on a shaft by a spring, such as a flexible arm or a load that swings"
  extends Interfaces.PartialFlange;
  parameter SI.Inertia J(min = 0) = 1e-4 "Moment of inertia that swings"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-9) = 0.5 "Period of the swing where the shaft is held"
    annotation(__Daest(estimate = true, role = "shape", of = "time", periods = "time", grid = {0.002, 0.0035, 0.006, 0.01, 0.018, 0.03, 0.055, 0.1, 0.17}));
  parameter Real zeta(unit = "1", min = 1e-4, max = 1) = 0.1 "Damping ratio of the swing"
    annotation(__Daest(estimate = true, role = "shape", grid = {0.15}));
  SI.Angle z(start = 0, stateSelect = StateSelect.prefer) "Angle of the inertia with respect to the shaft";
  SI.AngularVelocity r(start = 0, stateSelect = StateSelect.prefer) "Angular velocity of that";
  SI.AngularVelocity w "Angular velocity (= der(phi))";
equation
  w = der(phi);
  der(z) = r;
  der(r) = -(2*Daest.Constants.pi/T)^2*z - 4*Daest.Constants.pi*zeta/T*r - der(w);
  tau = J*((2*Daest.Constants.pi/T)^2*z + 4*Daest.Constants.pi*zeta/T*r);
  annotation(
    __Daest(effect = true, attach = "connector",
      law = "der(r) = -(2*pi/T)^2*z - 4*pi*zeta/T*r - der(w), der(z) = r, tau = J*((2*pi/T)^2*z + 4*pi*zeta/T*r)"),
    Documentation(info = "Rulers, cables, panels and hanging loads swing on what carries them. The
stiffness is J*(2*pi/T)^2; at the start the inertia moves with the shaft."));
end FlexibleAppendage;
