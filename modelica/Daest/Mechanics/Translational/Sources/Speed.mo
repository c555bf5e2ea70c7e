within Daest.Mechanics.Translational.Sources;
model Speed "Forced velocity of a flange as input signal"
  extends Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter Boolean exact = false
    "= true, if the velocity follows the signal exactly, otherwise through a filter of first order"
    annotation(Evaluate = true);
  parameter SI.Frequency f_crit = 50 "Critical frequency of the filter, if exact = false";
  Daest.Blocks.Interfaces.RealInput v_ref(unit = "m/s")
    "Reference velocity of the flange with respect to the support as input signal";
  SI.Position s(start = 0, stateSelect = StateSelect.prefer)
    "Position of the flange with respect to the support (= flange.s - support.s)";
  SI.Velocity v "Velocity of the flange with respect to the support (= der(s))";
equation
  s = flange.s - s_support;
  v = der(s);
  if exact then
    v = v_ref;
  else
    der(v) = 2*Daest.Constants.pi*f_crit*(v_ref - v);
  end if;
end Speed;
