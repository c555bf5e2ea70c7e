within Daest.Mechanics.Rotational.Components;
model Spring "Linear rotational spring"
  extends Interfaces.PartialCompliant;
  parameter SI.RotationalSpringConstant c(min = 0, start = 1) "Spring constant";
  parameter SI.Angle phi_rel0 = 0 "Relative angle of the unloaded spring";
equation
  tau = c*(phi_rel - phi_rel0);
end Spring;
