within Daest.Mechanics.Rotational.Sensors;
model TorqueSensor "Sensor of the torque between two flanges"
  extends Interfaces.PartialRelativeSensor;
  Daest.Blocks.Interfaces.RealOutput tau(unit = "N.m")
    "Torque that passes from flange_a to flange_b (= flange_a.tau = -flange_b.tau) as output signal";
equation
  flange_a.phi = flange_b.phi;
  flange_a.tau = tau;
end TorqueSensor;
