within Daest.Mechanics.Translational.Sensors;
model RelPositionSensor "Sensor of the relative position of two flanges"
  extends Interfaces.PartialRelativeSensor;
  Daest.Blocks.Interfaces.RealOutput s_rel(unit = "m")
    "Relative position (= flange_b.s - flange_a.s) as output signal";
equation
  s_rel = flange_b.s - flange_a.s;
  0 = flange_a.f;
end RelPositionSensor;
