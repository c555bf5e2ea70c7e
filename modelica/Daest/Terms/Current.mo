within Daest.Terms;
model Current "Current from a node of known voltage"
  input SI.Voltage v "Voltage of the node to ground";
  Daest.Electrical.Analog.Interfaces.NegativePin pin "Pin of the node";
  SI.Current total "Sum of the currents into what is connected";
equation
  pin.v = v;
  total = -pin.i;
end Current;
