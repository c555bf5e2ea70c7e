model Ladder "n sections of resistor and capacitor"
  import Daest.Electrical.Analog;
  parameter Integer n = 10;
  input Real u(unit = "V");
  output Real v(unit = "V") = capacitor[n].v;
  Analog.Sources.SignalVoltage source;
  Analog.Basic.Resistor resistor[n](each R = 10);
  Analog.Basic.Capacitor capacitor[n](each C = 0.001);
  Analog.Basic.Ground ground;
equation
  source.v = u;
  connect(source.n, ground.p);
  connect(source.p, resistor[1].p);
  for i in 1:n loop
    connect(resistor[i].n, capacitor[i].p);
    connect(capacitor[i].n, ground.p);
  end for;
  for i in 1:n-1 loop
    connect(resistor[i].n, resistor[i+1].p);
  end for;
end Ladder;
