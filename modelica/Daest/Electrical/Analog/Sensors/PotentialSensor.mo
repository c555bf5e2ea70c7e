within Daest.Electrical.Analog.Sensors;
model PotentialSensor "Sensor of the potential at a pin"
  Interfaces.PositivePin p "Pin whose potential is measured";
  Daest.Blocks.Interfaces.RealOutput phi(unit = "V") "Potential (= p.v) as output signal";
equation
  p.i = 0;
  phi = p.v;
end PotentialSensor;
