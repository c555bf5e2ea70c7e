within Daest.Effects.Translational;
model FlexibleAppendage "Mass that hangs on a body by a spring, such as a flexible part or a load that swings"
  extends Interfaces.PartialFlange;
  parameter SI.Mass m(min = 0) = 0.1 "Mass that swings"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-9) = 0.5 "Period of the swing where the body is held"
    annotation(__Daest(estimate = true, role = "shape", of = "time", periods = "time", grid = {0.002, 0.0035, 0.006, 0.01, 0.018, 0.03, 0.055, 0.1, 0.17}));
  parameter Real zeta(unit = "1", min = 1e-4, max = 1) = 0.1 "Damping ratio of the swing"
    annotation(__Daest(estimate = true, role = "shape", grid = {0.15}));
  SI.Position z(start = 0, stateSelect = StateSelect.prefer) "Position of the mass with respect to the body";
  SI.Velocity r(start = 0, stateSelect = StateSelect.prefer) "Velocity of that";
  SI.Velocity v "Velocity (= der(s))";
equation
  v = der(s);
  der(z) = r;
  der(r) = -(2*Daest.Constants.pi/T)^2*z - 4*Daest.Constants.pi*zeta/T*r - der(v);
  f = m*((2*Daest.Constants.pi/T)^2*z + 4*Daest.Constants.pi*zeta/T*r);
  annotation(
    __Daest(effect = true, attach = "connector",
      law = "der(r) = -(2*pi/T)^2*z - 4*pi*zeta/T*r - der(v), der(z) = r, f = m*((2*pi/T)^2*z + 4*pi*zeta/T*r)"),
    Documentation(info = "Rulers, cables, panels and hanging loads swing on what carries them. The
stiffness is m*(2*pi/T)^2; at the start the mass moves with the body."));
end FlexibleAppendage;
