within Daest.Terms;
model ForceOfSpeed "Force on a body of which the speed is known"
  input SI.Velocity v "Speed of the body";
  Daest.Mechanics.Translational.Interfaces.Flange_b flange "Flange of the body, whose position begins at zero";
  SI.Force total "Sum of the forces into what is connected";
equation
  der(flange.s) = v;
  total = -flange.f;
end ForceOfSpeed;
