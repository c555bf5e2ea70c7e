within Daest.Mechanics.Rotational.Sensors;
model RelAngleSensor "Sensor of the relative angle of two flanges"
  extends Interfaces.PartialRelativeSensor;
  Daest.Blocks.Interfaces.RealOutput phi_rel(unit = "rad")
    "Relative angle (= flange_b.phi - flange_a.phi) as output signal";
equation
  phi_rel = flange_b.phi - flange_a.phi;
  0 = flange_a.tau;
end RelAngleSensor;
