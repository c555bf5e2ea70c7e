within Daest.Terms;
model Torque "Torque on a body of known angle"
  input SI.Angle phi "Angle of the body";
  Daest.Mechanics.Rotational.Interfaces.Flange_b flange "Flange of the body";
  SI.Torque total "Sum of the torques into what is connected";
equation
  flange.phi = phi;
  total = -flange.tau;
end Torque;
