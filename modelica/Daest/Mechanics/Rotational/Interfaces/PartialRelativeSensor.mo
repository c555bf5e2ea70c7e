within Daest.Mechanics.Rotational.Interfaces;
partial model PartialRelativeSensor "Sensor between two flanges"
  extends PartialTwoFlanges;
equation
  flange_a.tau + flange_b.tau = 0;
end PartialRelativeSensor;
