within Daest.Mechanics.Rotational.Sources;
model Speed "Forced angular velocity of a flange as input signal"
  extends Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter Boolean exact = false
    "= true, if the angular velocity follows the signal exactly, otherwise through a filter of first order"
    annotation(Evaluate = true);
  parameter SI.Frequency f_crit = 50 "Critical frequency of the filter, if exact = false";
  Daest.Blocks.Interfaces.RealInput w_ref(unit = "rad/s")
    "Reference angular velocity of the flange with respect to the support as input signal";
  SI.Angle phi(start = 0, stateSelect = StateSelect.prefer)
    "Angle of the flange with respect to the support (= flange.phi - support.phi)";
  SI.AngularVelocity w "Angular velocity of the flange with respect to the support (= der(phi))";
equation
  phi = flange.phi - phi_support;
  w = der(phi);
  if exact then
    w = w_ref;
  else
    der(w) = 2*Daest.Constants.pi*f_crit*(w_ref - w);
  end if;
end Speed;
