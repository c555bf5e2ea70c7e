within Daest.Mechanics.Rotational.Sensors;
model AccSensor "Sensor of the absolute angular acceleration of a flange"
  extends Interfaces.PartialAbsoluteSensor;
  SI.AngularVelocity w "Absolute angular velocity of the flange (= der(flange.phi))";
  Daest.Blocks.Interfaces.RealOutput a(unit = "rad/s2")
    "Absolute angular acceleration of the flange (= der(w)) as output signal";
equation
  w = der(flange.phi);
  a = der(w);
end AccSensor;
