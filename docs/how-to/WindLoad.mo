model WindLoad "Wind against an arm"
  extends Daest.Effects.Rotational.Interfaces.PartialFriction;
  parameter Real k(unit = "N.m.s2/rad2", min = 0) = 0.01 "Torque per squared speed"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  tau = -k*w*abs(w);
  annotation(__Daest(effect = true, attach = "connector", law = "tau = -k*w*|w|"));
end WindLoad;
