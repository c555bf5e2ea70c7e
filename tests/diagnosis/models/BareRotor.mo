model BareRotor "The rotor in bare equations"
  parameter Real J(unit = "kg.m2", min = 0) = 0.5 "Inertia" annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.3 "Friction" annotation(__Daest(estimate = true, scale = "log"));
  input Real u(unit = "N.m") "Torque of the drive";
  output Real phi(unit = "rad") "Angle" annotation(__Daest(std = 0.005));
  Real w(unit = "rad/s") "Speed";
equation
  der(phi) = w;
  J*der(w) = u - d*w;
end BareRotor;
