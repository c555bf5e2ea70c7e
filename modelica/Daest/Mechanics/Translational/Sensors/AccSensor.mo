within Daest.Mechanics.Translational.Sensors;
model AccSensor "Sensor of the absolute acceleration of a flange"
  extends Interfaces.PartialAbsoluteSensor;
  SI.Velocity v "Absolute velocity of the flange (= der(flange.s))";
  Daest.Blocks.Interfaces.RealOutput a(unit = "m/s2")
    "Absolute acceleration of the flange (= der(v)) as output signal";
equation
  v = der(flange.s);
  a = der(v);
end AccSensor;
