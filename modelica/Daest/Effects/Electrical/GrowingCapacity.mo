within Daest.Effects.Electrical;
model GrowingCapacity "Capacity to ground that grows or falls with its voltage"
  Daest.Electrical.Analog.Interfaces.PositivePin pin "Pin of the capacity";
  parameter Real k(unit = "F/V") = 1 "Capacity per voltage"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  SI.Voltage v "Voltage to ground (= pin.v)";
  SI.Current i "Current that the capacity takes (= pin.i)";
equation
  v = pin.v;
  i = pin.i;
  i = k*v*der(v);
  annotation(
    __Daest(effect = true, attach = "connector", dynamic = true, of_store = true, law = "i = k*v*der(v)"),
    Documentation(info = "The double layer of a supercapacitor takes more charge per volt the fuller it is, a
ceramic capacitor less. It lies beside a capacity of the model, which is then that without voltage."));
end GrowingCapacity;
