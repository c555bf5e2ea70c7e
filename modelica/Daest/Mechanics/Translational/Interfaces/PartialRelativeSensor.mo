within Daest.Mechanics.Translational.Interfaces;
partial model PartialRelativeSensor "Sensor between two flanges"
  extends PartialTwoFlanges;
equation
  flange_a.f + flange_b.f = 0;
end PartialRelativeSensor;
