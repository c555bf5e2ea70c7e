within Daest.Mechanics.Rotational.Sensors;
model SpeedSensor "Sensor of the absolute angular velocity of a flange"
  extends Interfaces.PartialAbsoluteSensor;
  Daest.Blocks.Interfaces.RealOutput w(unit = "rad/s")
    "Absolute angular velocity of the flange (= der(flange.phi)) as output signal";
equation
  w = der(flange.phi);
end SpeedSensor;
