model Gears "n gears between inertias, a spring at the end: two modes at any size"
  import Daest.Mechanics.Rotational;
  parameter Integer n = 10;
  input Real u(unit = "N.m");
  output Real phi(unit = "rad") = inertia[n+1].phi;
  Rotational.Sources.Torque torque;
  Rotational.Components.Inertia inertia[n+1](each J = 0.1);
  Rotational.Components.IdealGear gear[n](ratio = {if mod(i, 2) == 0 then 2.5 else 0.4 for i in 1:n});
  Rotational.Components.SpringDamper spring(c = 10, d = 0.1);
  Rotational.Components.Fixed fixed;
equation
  torque.tau = u;
  connect(torque.flange, inertia[1].flange_a);
  for i in 1:n loop
    connect(inertia[i].flange_b, gear[i].flange_a);
    connect(gear[i].flange_b, inertia[i+1].flange_a);
  end for;
  connect(inertia[n+1].flange_b, spring.flange_a);
  connect(spring.flange_b, fixed.flange);
end Gears;
