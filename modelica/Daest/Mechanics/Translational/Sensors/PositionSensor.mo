within Daest.Mechanics.Translational.Sensors;
model PositionSensor "Sensor of the absolute position of a flange"
  extends Interfaces.PartialAbsoluteSensor;
  Daest.Blocks.Interfaces.RealOutput s(unit = "m") "Absolute position of the flange as output signal";
equation
  s = flange.s;
end PositionSensor;
