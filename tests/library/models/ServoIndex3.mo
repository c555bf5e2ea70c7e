model ServoIndex3 "Servo with support flanges, accelerations and relative acceleration as variables: index 3"
  import Daest.Units.SI;

  parameter SI.RotationalDampingConstant d = 0.02 "Damping of the spring";
  parameter SI.RotationalSpringConstant c = 1.5 "Stiffness of the spring";
  parameter SI.Inertia J1 = 6.3e-6 "Inertia of the motor";
  parameter SI.Inertia J2 = 0.02 "Inertia of the disc";
  parameter SI.Resistance R = 4.6 "Resistance of the motor";
  parameter SI.ElectricalTorqueConstant k = 0.06 "Torque constant of the motor";

  Daest.Blocks.Interfaces.RealInput u(unit = "V", start = 0) "Voltage of the amplifier";
  Daest.Blocks.Interfaces.RealOutput omega(unit = "rad/s") "Angular velocity after the gear, before the spring";
  Daest.Blocks.Interfaces.RealOutput phi(unit = "rad") "Angle of the disc";

  Daest.Electrical.Analog.Sources.SignalVoltage source "Amplifier";
  Daest.Electrical.Analog.Basic.Ground ground "Reference of the potentials";
  Daest.Electrical.Analog.Basic.Resistor resistor(R = R) "Winding of the motor";
  Daest.Electrical.Analog.Basic.RotationalEMF emf(k = k, useSupport = true) "Air gap of the motor";
  Daest.Mechanics.Rotational.Components.Fixed motor_housing "Housing of the motor";
  Daest.Mechanics.Rotational.Components.Fixed gear_housing "Housing of the gear";
  Daest.Mechanics.Rotational.Components.Inertia motor(J = J1) "Rotor of the motor";
  Daest.Mechanics.Rotational.Components.IdealGear gear(ratio = 30, useSupport = true) "Gear";
  Daest.Mechanics.Rotational.Sensors.TorqueSensor coupling "Torque sensor between gear and spring";
  Daest.Mechanics.Rotational.Components.SpringDamper spring(c = c, d = d) "Spring between gear and disc";
  Daest.Mechanics.Rotational.Components.Inertia disc(J = J2) "Disc";
  Daest.Mechanics.Rotational.Sensors.SpeedSensor tachometer "Speed sensor after the gear";
  Daest.Mechanics.Rotational.Sensors.AngleSensor encoder "Angle sensor on the disc";
equation
  connect(u, source.v);
  connect(source.p, resistor.p);
  connect(resistor.n, emf.p);
  connect(emf.n, source.n);
  connect(source.n, ground.p);
  connect(emf.flange, motor.flange_a);
  connect(emf.support, motor_housing.flange);
  connect(gear.support, gear_housing.flange);
  connect(motor.flange_b, gear.flange_a);
  connect(gear.flange_b, coupling.flange_a);
  connect(coupling.flange_b, spring.flange_a);
  connect(spring.flange_b, disc.flange_a);
  connect(gear.flange_b, tachometer.flange);
  connect(disc.flange_b, encoder.flange);
  connect(tachometer.w, omega);
  connect(encoder.phi, phi);
end ServoIndex3;
