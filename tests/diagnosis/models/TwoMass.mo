model TwoMass "A drive behind a gear turns a disc through a spring; both angles measured"
  import Daest.Units.SI;
  parameter SI.Inertia J1(min = 0) = 0.01 "Inertia of the drive" annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.Inertia J2(min = 0) = 0.5 "Inertia of the disc" annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.RotationalSpringConstant c(min = 0) = 4 "Stiffness" annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.RotationalDampingConstant d(min = 0) = 0.2 "Damping" annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput u(unit = "N.m") "Torque of the drive";
  Daest.Blocks.Interfaces.RealOutput a(unit = "rad") "Angle of the drive" annotation(__Daest(std = 0.005));
  Daest.Blocks.Interfaces.RealOutput b(unit = "rad") "Angle of the disc" annotation(__Daest(std = 0.005));
  Daest.Mechanics.Rotational.Sources.Torque drive "Drive";
  Daest.Mechanics.Rotational.Components.Inertia motor(J = J1) "Rotor of the drive";
  Daest.Mechanics.Rotational.Components.IdealGear gear(ratio = 5) "Gear";
  Daest.Mechanics.Rotational.Components.SpringDamper spring(c = c, d = d) "Spring";
  Daest.Mechanics.Rotational.Components.Inertia disc(J = J2) "Disc";
  Daest.Mechanics.Rotational.Components.Inertia loose(J = J2) "A flywheel that nothing is connected to";
  Daest.Mechanics.Rotational.Sensors.AngleSensor first "Encoder of the drive";
  Daest.Mechanics.Rotational.Sensors.AngleSensor second "Encoder of the disc";
equation
  connect(u, drive.tau);
  connect(drive.flange, motor.flange_a);
  connect(motor.flange_b, gear.flange_a);
  connect(gear.flange_b, spring.flange_a);
  connect(spring.flange_b, disc.flange_a);
  connect(motor.flange_b, first.flange);
  connect(disc.flange_b, second.flange);
  connect(first.phi, a);
  connect(second.phi, b);
end TwoMass;
