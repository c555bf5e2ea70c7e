within Daest.Electrical.Analog.Sensors;
model CurrentSensor "Sensor of the current in a branch"
  Interfaces.PositivePin p "Positive pin";
  Interfaces.NegativePin n "Negative pin";
  Daest.Blocks.Interfaces.RealOutput i(unit = "A") "Current flowing from pin p to pin n (= p.i) as output signal";
equation
  p.v = n.v;
  p.i = i;
  n.i = -i;
end CurrentSensor;
