within Daest.Mechanics.Rotational.Sensors;
model AngleSensor "Sensor of the absolute angle of a flange"
  extends Interfaces.PartialAbsoluteSensor;
  Daest.Blocks.Interfaces.RealOutput phi(unit = "rad") "Absolute angle of the flange as output signal";
equation
  phi = flange.phi;
end AngleSensor;
