within Daest.Effects.Electrical;
model GroundLeakage "Current from a node to ground past an insulation"
  Daest.Electrical.Analog.Interfaces.PositivePin pin "Pin at the node";
  parameter SI.Conductance G(min = 0) = 1e-3 "Conductance of the leak"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  SI.Voltage v "Voltage to ground (= pin.v)";
  SI.Current i "Current that leaks (= pin.i)";
equation
  v = pin.v;
  i = pin.i;
  i = G*v;
  annotation(
    __Daest(effect = true, attach = "connector", of_equation = true, law = "i = G*v"),
    Documentation(info = "What Leakage is beside a component, at the node of a capacity of bare equations such
as C*der(v) = i: a capacitor that discharges itself, a load, a voltmeter."));
end GroundLeakage;
