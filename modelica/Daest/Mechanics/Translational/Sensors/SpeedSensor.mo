within Daest.Mechanics.Translational.Sensors;
model SpeedSensor "Sensor of the absolute velocity of a flange"
  extends Interfaces.PartialAbsoluteSensor;
  Daest.Blocks.Interfaces.RealOutput v(unit = "m/s")
    "Absolute velocity of the flange (= der(flange.s)) as output signal";
equation
  v = der(flange.s);
end SpeedSensor;
