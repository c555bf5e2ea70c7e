model Servo "Spring servo of Gerdin and Schoen (2004): DC motor, gear, spring with damper, disc; 54 equations"
  import Daest.Units.SI;

  model EMF "Converter between electrical and rotational power, without support and angle"
    extends Daest.Electrical.Analog.Interfaces.OnePort;
    parameter SI.ElectricalTorqueConstant k "Torque over current, and voltage over speed";
    SI.AngularVelocity w "Angular velocity of the flange (= der(flange.phi))";
    Daest.Mechanics.Rotational.Interfaces.Flange_b flange "Flange of the shaft";
  equation
    w = der(flange.phi);
    k*w = v;
    flange.tau = -k*i;
  end EMF;

  model Gear "Gear without inertia, loss and support"
    extends Daest.Mechanics.Rotational.Interfaces.PartialTwoFlanges;
    parameter Real ratio(unit = "1") "Transmission ratio (flange_a.phi/flange_b.phi)";
  equation
    flange_a.phi = ratio*flange_b.phi;
    0 = ratio*flange_a.tau + flange_b.tau;
  end Gear;

  model Damper "Linear rotational damper without relative acceleration"
    extends Daest.Mechanics.Rotational.Interfaces.PartialCompliant;
    parameter SI.RotationalDampingConstant d "Damping constant";
    SI.AngularVelocity w_rel "Relative angular velocity (= der(phi_rel))";
  equation
    w_rel = der(phi_rel);
    tau = d*w_rel;
  end Damper;

  parameter SI.RotationalDampingConstant d(min = 0, nominal = 1e-3) = 5.43e-4 "Damping of the spring"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.RotationalSpringConstant c(min = 0, nominal = 0.1) = 0.0362 "Stiffness of the spring"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.Inertia J1(min = 0, nominal = 1e-5) = 3.0e-6 "Inertia of the motor"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.Inertia J2(min = 0, nominal = 1e-3) = 3.66e-4 "Inertia of the disc"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.Resistance R(min = 0) = 4.50 "Resistance of the motor, measured";
  parameter SI.ElectricalTorqueConstant k(nominal = 0.1) = -0.060
    "Torque constant of the motor; negative because the amplifier drives it with reversed poles"
    annotation(__Daest(estimate = true));

  Daest.Blocks.Interfaces.RealInput u(unit = "V", start = 0) "Voltage of the amplifier";
  output SI.AngularVelocity omega = motor.w/gear.ratio "Angular velocity after the gear, before the spring"
    annotation(__Daest(std = 0.02));
  output SI.Angle phi = disc.phi "Angle of the disc" annotation(__Daest(std = 0.01));

  Daest.Electrical.Analog.Sources.SignalVoltage source "Amplifier";
  Daest.Electrical.Analog.Basic.Ground ground "Reference of the potentials";
  Daest.Electrical.Analog.Basic.Resistor resistor(R = R) "Winding of the motor";
  EMF emf(k = k) "Air gap of the motor";
  Daest.Mechanics.Rotational.Components.Inertia motor(J = J1) "Rotor of the motor";
  Gear gear(ratio = 30) "Gear";
  Daest.Mechanics.Rotational.Components.Spring spring(c = c) "Spring between gear and disc";
  Damper damper(d = d) "Damping of the spring";
  Daest.Mechanics.Rotational.Components.Inertia disc(J = J2) "Disc";
equation
  connect(u, source.v);
  connect(source.n, resistor.p);
  connect(resistor.n, emf.p);
  connect(emf.n, source.p);
  connect(source.p, ground.p);
  connect(emf.flange, motor.flange_a);
  connect(motor.flange_b, gear.flange_a);
  connect(gear.flange_b, spring.flange_a);
  connect(gear.flange_b, damper.flange_a);
  connect(spring.flange_b, disc.flange_a);
  connect(damper.flange_b, disc.flange_a);
end Servo;
