within Daest.Electrical.Analog.Sources;
model SignalVoltage "Voltage source whose voltage is a signal"
  Interfaces.PositivePin p "Positive pin";
  Interfaces.NegativePin n "Negative pin";
  Daest.Blocks.Interfaces.RealInput v(unit = "V")
    "Voltage between pin p and pin n (= p.v - n.v) as input signal";
  SI.Current i "Current flowing from pin p to pin n (= p.i)";
equation
  v = p.v - n.v;
  0 = p.i + n.i;
  i = p.i;
end SignalVoltage;
