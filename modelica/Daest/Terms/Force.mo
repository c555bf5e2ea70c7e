within Daest.Terms;
model Force "Force on a body of known position"
  input SI.Position s "Position of the body";
  Daest.Mechanics.Translational.Interfaces.Flange_b flange "Flange of the body";
  SI.Force total "Sum of the forces into what is connected";
equation
  flange.s = s;
  total = -flange.f;
end Force;
