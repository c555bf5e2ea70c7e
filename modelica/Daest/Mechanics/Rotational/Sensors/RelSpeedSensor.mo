within Daest.Mechanics.Rotational.Sensors;
model RelSpeedSensor "Sensor of the relative angular velocity of two flanges"
  extends Interfaces.PartialRelativeSensor;
  SI.Angle phi_rel "Relative angle (= flange_b.phi - flange_a.phi)";
  Daest.Blocks.Interfaces.RealOutput w_rel(unit = "rad/s")
    "Relative angular velocity (= der(phi_rel)) as output signal";
equation
  phi_rel = flange_b.phi - flange_a.phi;
  w_rel = der(phi_rel);
  0 = flange_a.tau;
end RelSpeedSensor;
