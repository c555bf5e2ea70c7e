model Servo "Spring servo: DC motor, gear, spring with damper, disc; speed after the gear and angle of the disc measured"
  import Daest.Units.SI;

  parameter SI.RotationalDampingConstant d(min = 0, nominal = 0.02) = 0.02 "Damping of the spring"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.RotationalSpringConstant c(min = 0, nominal = 1) = 1.5 "Stiffness of the spring"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.Inertia J1(min = 0, nominal = 1e-5) = 6.3e-6 "Inertia of the motor"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.Inertia J2(min = 0, nominal = 0.02) = 0.02 "Inertia of the disc"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.Resistance R(min = 0) = 4.31617 "Resistance of the motor, measured on the bench";
  parameter SI.ElectricalTorqueConstant k(min = 0, nominal = 0.1) = 0.06 "Torque constant of the motor"
    annotation(__Daest(estimate = true, scale = "log"));

  Daest.Blocks.Interfaces.RealInput u(unit = "V", start = 0) "Voltage of the amplifier";
  Daest.Blocks.Interfaces.RealOutput omega(unit = "rad/s") "Angular velocity after the gear, before the spring"
    annotation(__Daest(std = 0.02));
  Daest.Blocks.Interfaces.RealOutput phi(unit = "rad") "Angle of the disc" annotation(__Daest(std = 0.01));

  Daest.Electrical.Analog.Sources.SignalVoltage source "Amplifier";
  Daest.Electrical.Analog.Basic.Ground ground "Reference of the potentials";
  Daest.Electrical.Analog.Basic.Resistor resistor(R = R) "Winding of the motor";
  Daest.Electrical.Analog.Basic.RotationalEMF emf(k = k) "Air gap of the motor";
  Daest.Mechanics.Rotational.Components.Inertia motor(J = J1) "Rotor of the motor";
  Daest.Mechanics.Rotational.Components.IdealGear gear(ratio = 30) "Gear";
  Daest.Mechanics.Rotational.Components.SpringDamper spring(c = c, d = d) "Spring between gear and disc";
  Daest.Mechanics.Rotational.Components.Inertia disc(J = J2) "Disc";
  Daest.Mechanics.Rotational.Sensors.SpeedSensor tachometer "Speed sensor after the gear";
  Daest.Mechanics.Rotational.Sensors.AngleSensor encoder "Angle sensor on the disc";
  Daest.Noise.WhiteTorque disturbance(intensity = 1e-6) "Unmodelled torque on the disc";
equation
  connect(u, source.v);
  connect(source.p, resistor.p);
  connect(resistor.n, emf.p);
  connect(emf.n, source.n);
  connect(source.n, ground.p);
  connect(emf.flange, motor.flange_a);
  connect(motor.flange_b, gear.flange_a);
  connect(gear.flange_b, spring.flange_a);
  connect(spring.flange_b, disc.flange_a);
  connect(gear.flange_b, tachometer.flange);
  connect(disc.flange_b, encoder.flange);
  connect(disturbance.flange, disc.flange_b);
  connect(tachometer.w, omega);
  connect(encoder.phi, phi);
end Servo;
