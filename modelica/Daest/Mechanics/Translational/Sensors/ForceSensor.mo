within Daest.Mechanics.Translational.Sensors;
model ForceSensor "Sensor of the force between two flanges"
  extends Interfaces.PartialRelativeSensor;
  Daest.Blocks.Interfaces.RealOutput f(unit = "N")
    "Force that passes from flange_a to flange_b (= flange_a.f = -flange_b.f) as output signal";
equation
  flange_a.s = flange_b.s;
  flange_a.f = f;
end ForceSensor;
