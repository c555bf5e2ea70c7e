model Servo "Motor, gear, spring and disc as equations of motion"
  parameter Real J1(unit = "kg.m2", min = 0) = 6.3e-6 "Inertia of the motor"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter Real J2(unit = "kg.m2", min = 0) = 0.02 "Inertia of the disc"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter Real c(unit = "N.m/rad", min = 0) = 1.5 "Stiffness of the spring"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.02 "Damping of the spring"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter Real k(unit = "N.m/A") = 0.06 "Torque constant" annotation(__Daest(estimate = true));
  parameter Real R(unit = "Ohm") = 4.31617 "Resistance, measured";
  constant Real n = 30 "Ratio of the gear";
  input Real u(unit = "V") "Voltage";
  input Real load(unit = "N.m") "White torque on the disc"
    annotation(__Daest(noise = true, intensity = 1e-6));
  output Real omega(unit = "rad/s") "Speed after the gear" annotation(__Daest(std = 0.02));
  output Real phi(unit = "rad") "Angle of the disc" annotation(__Daest(std = 0.01));
  Real angle(unit = "rad") "Angle after the gear";
  Real speed(unit = "rad/s") "Speed of the disc";
  Real i(unit = "A") "Current";
  Real tau(unit = "N.m") "Torque of the spring";
equation
  der(angle) = omega;
  der(phi) = speed;
  u = R*i + n*k*omega;
  tau = c*(angle - phi) + d*(omega - speed);
  n^2*J1*der(omega) = n*k*i - tau;
  J2*der(speed) = tau + load;
end Servo;
