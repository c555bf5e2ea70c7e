model Rotor "A torque turns a rotor against viscous friction; its angle is measured"
  import Daest.Units.SI;
  parameter SI.Inertia J(min = 0) = 0.5 "Inertia" annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.RotationalDampingConstant d(min = 0) = 0.3 "Friction" annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput u(unit = "N.m") "Torque of the drive";
  Daest.Blocks.Interfaces.RealOutput phi(unit = "rad") "Angle" annotation(__Daest(std = 0.005));
  Daest.Mechanics.Rotational.Sources.Torque drive "Drive";
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = J) "Rotor";
  Daest.Mechanics.Rotational.Components.Damper bearing(d = d) "Bearing";
  Daest.Mechanics.Rotational.Components.Fixed housing "Housing";
  Daest.Mechanics.Rotational.Sensors.AngleSensor encoder "Encoder";
  Daest.Noise.WhiteTorque disturbance(intensity = 1e-4) "Unmodelled torque";
equation
  connect(u, drive.tau);
  connect(drive.flange, rotor.flange_a);
  connect(rotor.flange_b, bearing.flange_a);
  connect(bearing.flange_b, housing.flange);
  connect(rotor.flange_b, encoder.flange);
  connect(disturbance.flange, rotor.flange_b);
  connect(encoder.phi, phi);
end Rotor;
