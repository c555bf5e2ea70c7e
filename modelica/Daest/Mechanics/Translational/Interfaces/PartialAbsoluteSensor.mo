within Daest.Mechanics.Translational.Interfaces;
partial model PartialAbsoluteSensor "Sensor of the absolute motion of a flange"
  Flange_a flange "Flange whose motion is measured";
equation
  flange.f = 0;
end PartialAbsoluteSensor;
