within Daest.Electrical.Analog.Sources;
model SignalCurrent "Current source whose current is a signal"
  Interfaces.PositivePin p "Positive pin";
  Interfaces.NegativePin n "Negative pin";
  SI.Voltage v "Voltage drop between the two pins (= p.v - n.v)";
  Daest.Blocks.Interfaces.RealInput i(unit = "A") "Current flowing from pin p to pin n (= p.i) as input signal";
equation
  v = p.v - n.v;
  0 = p.i + n.i;
  i = p.i;
end SignalCurrent;
