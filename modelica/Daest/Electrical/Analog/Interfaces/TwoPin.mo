within Daest.Electrical.Analog.Interfaces;
partial model TwoPin "Component with two pins"
  SI.Voltage v "Voltage drop between the two pins (= p.v - n.v)";
  PositivePin p "Positive pin";
  NegativePin n "Negative pin";
equation
  v = p.v - n.v;
end TwoPin;
