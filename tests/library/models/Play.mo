model Play "An inertia in a coupling with play"
  Daest.Blocks.Interfaces.RealInput tau(unit = "N.m") "Torque";
  Daest.Blocks.Interfaces.RealOutput phi(unit = "rad") "Angle";
  Daest.Mechanics.Rotational.Sources.Torque drive "Drive";
  Daest.Mechanics.Rotational.Components.Inertia inertia(J = 0.5, phi(start = 0.2)) "Inertia";
  Daest.Mechanics.Rotational.Components.ElastoBacklash play(c = 3, d = 0.2, b = 0.1) "Coupling with play";
  Daest.Mechanics.Rotational.Components.Fixed wall "Wall";
  Daest.Mechanics.Rotational.Sensors.AngleSensor angle "Angle sensor";
equation
  connect(tau, drive.tau);
  connect(drive.flange, inertia.flange_a);
  connect(inertia.flange_b, play.flange_a);
  connect(play.flange_b, wall.flange);
  connect(inertia.flange_b, angle.flange);
  connect(angle.phi, phi);
end Play;
