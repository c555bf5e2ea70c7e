model SpeedRotor "A rotor in one bare equation; its speed is measured"
  parameter Real J(unit = "kg.m2", min = 0) = 0.5 "Inertia" annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.3 "Friction" annotation(__Daest(estimate = true, scale = "log"));
  input Real u(unit = "N.m") "Torque of the drive";
  output Real w(unit = "rad/s") "Speed" annotation(__Daest(std = 0.02));
equation
  J*der(w) = u - d*w;
end SpeedRotor;
