model SpeedMachine "The rotor from components; its speed is measured, its angle is not"
  import Daest.Units.SI;
  parameter SI.Inertia J(min = 0) = 0.5 "Inertia" annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.RotationalDampingConstant d(min = 0) = 0.3 "Friction" annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput u(unit = "N.m") "Torque of the drive";
  Daest.Blocks.Interfaces.RealOutput w(unit = "rad/s") "Speed" annotation(__Daest(std = 0.02));
  Daest.Mechanics.Rotational.Sources.Torque drive "Drive";
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = J) "Rotor";
  Daest.Mechanics.Rotational.Components.Damper bearing(d = d) "Bearing";
  Daest.Mechanics.Rotational.Components.Fixed housing "Housing";
  Daest.Mechanics.Rotational.Sensors.SpeedSensor encoder "Tachometer";
equation
  connect(u, drive.tau);
  connect(drive.flange, rotor.flange_a);
  connect(rotor.flange_b, bearing.flange_a);
  connect(bearing.flange_b, housing.flange);
  connect(rotor.flange_b, encoder.flange);
  connect(encoder.w, w);
end SpeedMachine;
