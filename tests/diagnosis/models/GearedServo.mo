model GearedServo "Geared servo with a pendulum"
  parameter Real J(unit = "kg.m2", min = 0, nominal = 0.01) = 0.006 "Inertia of arm, gear and rotor"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.m.s/rad", min = 0, nominal = 0.01) = 0.01 "Viscous friction"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter Real k(unit = "N.m/A", min = 0, nominal = 0.1) = 0.4 "Torque constant at the arm"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R(unit = "Ohm", min = 0, nominal = 1) = 4 "Resistance";
  parameter Real zero(unit = "rad", nominal = 0.1) = -0.025 "Reading with the pendulum hanging"
    annotation(__Daest(estimate = true));
  input Real duty "Duty cycle";
  input Real supply(unit = "V") "Supply";
  input Real on "1 where the motor is on";
  Daest.Blocks.Interfaces.RealOutput angle(unit = "rad") "Reading of the encoder" annotation(__Daest(std = 5e-4));
  Daest.Mechanics.Rotational.Components.Inertia arm(J = J) "Arm, gear and rotor";
  Daest.Mechanics.Rotational.Components.Damper friction(d = d) "Friction of the gear";
  Daest.Mechanics.Rotational.Components.Fixed frame "Frame";
  Daest.Mechanics.Rotational.Sources.Torque gravity "Weight";
  Daest.Mechanics.Rotational.Sources.Torque motor "Motor";
  Daest.Mechanics.Rotational.Sensors.AngleSensor encoder "Encoder";
  Daest.Noise.WhiteTorque disturbance(intensity = 1e-7) "Unmodelled torque";
equation
  gravity.tau = -0.49*9.81*0.1*sin(arm.phi - zero);
  motor.tau = on*k/R*(duty*supply/1000 - k*arm.w);
  connect(gravity.flange, arm.flange_b);
  connect(motor.flange, arm.flange_b);
  connect(frame.flange, friction.flange_a);
  connect(friction.flange_b, arm.flange_a);
  connect(disturbance.flange, arm.flange_a);
  connect(encoder.flange, arm.flange_b);
  connect(encoder.phi, angle);
end GearedServo;
