within Daest.Effects.Rotational.Interfaces;
partial model PartialRelative "Effect on a shaft, against the housing or another shaft"
  extends Daest.Mechanics.Rotational.Interfaces.PartialElementaryOneFlangeAndSupport2;
  SI.Angle phi "Angle of the flange with respect to the support (= flange.phi - support.phi)";
  SI.Torque tau "Torque of the effect on the shaft (= -flange.tau)";
equation
  phi = flange.phi - phi_support;
  flange.tau = -tau;
end PartialRelative;
