model Rigid "n inertias coupled rigidly, a spring at the end: two modes at any size"
  import Daest.Mechanics.Rotational;
  parameter Integer n = 10;
  input Real u(unit = "N.m");
  output Real phi(unit = "rad") = inertia[n].phi;
  Rotational.Sources.Torque torque;
  Rotational.Components.Inertia inertia[n](each J = 0.1);
  Rotational.Components.SpringDamper spring(c = 10, d = 0.1);
  Rotational.Components.Fixed fixed;
equation
  torque.tau = u;
  connect(torque.flange, inertia[1].flange_a);
  for i in 1:n-1 loop
    connect(inertia[i].flange_b, inertia[i+1].flange_a);
  end for;
  connect(inertia[n].flange_b, spring.flange_a);
  connect(spring.flange_b, fixed.flange);
end Rigid;
