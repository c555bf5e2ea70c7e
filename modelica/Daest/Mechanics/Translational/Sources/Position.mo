within Daest.Mechanics.Translational.Sources;
model Position "Forced position of a flange as input signal"
  extends Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter Boolean exact = false
    "= true, if the position follows the signal exactly, otherwise through a filter of second order"
    annotation(Evaluate = true);
  parameter SI.Frequency f_crit = 50 "Critical frequency of the filter, if exact = false";
  Daest.Blocks.Interfaces.RealInput s_ref(unit = "m")
    "Reference position of the flange with respect to the support as input signal";
  SI.Position s(stateSelect = if exact then StateSelect.default else StateSelect.prefer)
    "Position of the flange with respect to the support (= flange.s - support.s)";
  SI.Velocity v(start = 0, stateSelect = if exact then StateSelect.default else StateSelect.prefer)
    "Velocity of the flange with respect to the support (= der(s))";
  SI.Acceleration a "Acceleration of the flange with respect to the support (= der(v))";
protected
  constant Real af = 1.3617 "Damping of the Bessel filter";
  constant Real bf = 0.6180 "Squared time constant of the Bessel filter";
  parameter Real w_crit(unit = "rad/s") = 2*Daest.Constants.pi*f_crit "Critical angular frequency";
equation
  s = flange.s - s_support;
  v = der(s);
  a = der(v);
  if exact then
    s = s_ref;
  else
    a = ((s_ref - s)*w_crit - af*v)*(w_crit/bf);
  end if;
end Position;
