within Daest.Terms;
model TorqueOfSpeed "Torque on a body of which the speed is known"
  input SI.AngularVelocity w "Speed of the body";
  Daest.Mechanics.Rotational.Interfaces.Flange_b flange "Flange of the body, whose angle begins at zero";
  SI.Torque total "Sum of the torques into what is connected";
equation
  der(flange.phi) = w;
  total = -flange.tau;
end TorqueOfSpeed;
