within Daest.Mechanics.Rotational.Sources;
model Position "Forced angle of a flange as input signal"
  extends Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter Boolean exact = false
    "= true, if the angle follows the signal exactly, otherwise through a filter of second order"
    annotation(Evaluate = true);
  parameter SI.Frequency f_crit = 50 "Critical frequency of the filter, if exact = false";
  Daest.Blocks.Interfaces.RealInput phi_ref(unit = "rad")
    "Reference angle of the flange with respect to the support as input signal";
  SI.Angle phi(stateSelect = if exact then StateSelect.default else StateSelect.prefer)
    "Angle of the flange with respect to the support (= flange.phi - support.phi)";
  SI.AngularVelocity w(start = 0, stateSelect = if exact then StateSelect.default else StateSelect.prefer)
    "Angular velocity of the flange with respect to the support (= der(phi))";
  SI.AngularAcceleration a "Angular acceleration of the flange with respect to the support (= der(w))";
protected
  constant Real af = 1.3617 "Damping of the Bessel filter";
  constant Real bf = 0.6180 "Squared time constant of the Bessel filter";
  parameter Real w_crit(unit = "rad/s") = 2*Daest.Constants.pi*f_crit "Critical angular frequency";
equation
  phi = flange.phi - phi_support;
  w = der(phi);
  a = der(w);
  if exact then
    phi = phi_ref;
  else
    a = ((phi_ref - phi)*w_crit - af*w)*(w_crit/bf);
  end if;
end Position;
