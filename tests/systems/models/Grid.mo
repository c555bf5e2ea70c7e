model Grid "n by n masses, springs between neighbours and to the ground at the corners"
  import Daest.Mechanics.Translational;
  parameter Integer n = 3;
  input Real u(unit = "N");
  output Real s(unit = "m") = mass[n, n].s;
  Translational.Sources.Force force;
  Translational.Components.Mass mass[n, n](each m = 0.1);
  Translational.Components.SpringDamper right[n, n - 1](each c = 10, each d = 0.1);
  Translational.Components.SpringDamper down[n - 1, n](each c = 10, each d = 0.1);
  Translational.Components.SpringDamper corner(c = 10, d = 0.1);
  Translational.Components.Fixed fixed;
equation
  force.f = u;
  connect(force.flange, mass[1, 1].flange_a);
  for i in 1:n loop
    for j in 1:n-1 loop
      connect(mass[i, j].flange_b, right[i, j].flange_a);
      connect(right[i, j].flange_b, mass[i, j + 1].flange_a);
    end for;
  end for;
  for i in 1:n-1 loop
    for j in 1:n loop
      connect(mass[i, j].flange_b, down[i, j].flange_a);
      connect(down[i, j].flange_b, mass[i + 1, j].flange_a);
    end for;
  end for;
  connect(mass[n, n].flange_b, corner.flange_a);
  connect(corner.flange_b, fixed.flange);
end Grid;
