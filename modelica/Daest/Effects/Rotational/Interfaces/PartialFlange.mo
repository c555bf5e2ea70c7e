within Daest.Effects.Rotational.Interfaces;
partial model PartialFlange "Effect on a shaft, against the housing"
  Daest.Mechanics.Rotational.Interfaces.Flange_b flange "Flange of the shaft";
  SI.Angle phi "Angle of the flange (= flange.phi)";
  SI.Torque tau "Torque of the effect on the shaft (= -flange.tau)";
equation
  phi = flange.phi;
  flange.tau = -tau;
end PartialFlange;
