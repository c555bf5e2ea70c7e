within Daest.Mechanics.Translational.Sensors;
model RelSpeedSensor "Sensor of the relative velocity of two flanges"
  extends Interfaces.PartialRelativeSensor;
  SI.Position s_rel "Relative position (= flange_b.s - flange_a.s)";
  Daest.Blocks.Interfaces.RealOutput v_rel(unit = "m/s")
    "Relative velocity (= der(s_rel)) as output signal";
equation
  s_rel = flange_b.s - flange_a.s;
  v_rel = der(s_rel);
  0 = flange_a.f;
end RelSpeedSensor;
