within Daest.Electrical.Analog.Sensors;
model VoltageSensor "Sensor of the voltage between two pins"
  Interfaces.PositivePin p "Positive pin";
  Interfaces.NegativePin n "Negative pin";
  Daest.Blocks.Interfaces.RealOutput v(unit = "V")
    "Voltage between pin p and pin n (= p.v - n.v) as output signal";
equation
  p.i = 0;
  n.i = 0;
  v = p.v - n.v;
end VoltageSensor;
