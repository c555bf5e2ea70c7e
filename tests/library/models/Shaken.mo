model Shaken "Bodies on springs whose ends are moved: one exactly, one through a filter"
  Daest.Blocks.Interfaces.RealInput z(unit = "m") "Position of the table";
  Daest.Blocks.Interfaces.RealInput angle(unit = "rad") "Angle of the shaft";
  Daest.Blocks.Interfaces.RealOutput s(unit = "m") "Position of the body";
  Daest.Blocks.Interfaces.RealOutput phi(unit = "rad") "Angle of the disc";
  Daest.Mechanics.Translational.Sources.Position table(exact = true) "Table";
  Daest.Mechanics.Translational.Components.SpringDamper mount(c = 7, d = 0.6) "Mount";
  Daest.Mechanics.Translational.Components.Mass body(m = 1.5) "Body";
  Daest.Mechanics.Translational.Sensors.PositionSensor seen "Position sensor";
  Daest.Mechanics.Rotational.Sources.Position shaft(f_crit = 0.4) "Shaft";
  Daest.Mechanics.Rotational.Components.SpringDamper coupling(c = 3, d = 0.2) "Coupling";
  Daest.Mechanics.Rotational.Components.Inertia disc(J = 0.8) "Disc";
  Daest.Mechanics.Rotational.Sensors.AngleSensor encoder "Angle sensor";
equation
  connect(z, table.s_ref);
  connect(table.flange, mount.flange_a);
  connect(mount.flange_b, body.flange_a);
  connect(body.flange_b, seen.flange);
  connect(seen.s, s);
  connect(angle, shaft.phi_ref);
  connect(shaft.flange, coupling.flange_a);
  connect(coupling.flange_b, disc.flange_a);
  connect(disc.flange_b, encoder.flange);
  connect(encoder.phi, phi);
end Shaken;
