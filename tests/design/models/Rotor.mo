model Rotor "A rotor in a bearing with viscous friction, driven by a torque"
  import Daest.Units.SI;
  parameter SI.Inertia J(min = 0, nominal = 0.1) = 0.08 "Inertia" annotation(__Daest(estimate = true));
  parameter SI.RotationalDampingConstant d(min = 0, nominal = 0.1) = 0.1 "Bearing" annotation(__Daest(estimate = true));
  Daest.Blocks.Interfaces.RealInput tau(unit = "N.m", start = 0) "Torque of the drive";
  Daest.Blocks.Interfaces.RealOutput w(unit = "rad/s") "Speed" annotation(__Daest(std = 0.05));
  Daest.Mechanics.Rotational.Sources.Torque drive;
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = J);
  Daest.Mechanics.Rotational.Components.Damper bearing(d = d);
  Daest.Mechanics.Rotational.Components.Fixed housing;
  Daest.Mechanics.Rotational.Sensors.SpeedSensor tachometer;
equation
  connect(tau, drive.tau);
  connect(drive.flange, rotor.flange_a);
  connect(rotor.flange_b, bearing.flange_a);
  connect(bearing.flange_b, housing.flange);
  connect(rotor.flange_b, tachometer.flange);
  connect(tachometer.w, w);
end Rotor;
