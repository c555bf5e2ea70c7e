model Resistors "n sections of two resistors between two capacitors: two modes at any size"
  import Daest.Electrical.Analog;
  parameter Integer n = 10;
  input Real u(unit = "V");
  output Real v(unit = "V") = last.v;
  Analog.Sources.SignalVoltage source;
  Analog.Basic.Resistor along[n](each R = 1);
  Analog.Basic.Resistor across[n](each R = 1000);
  Analog.Basic.Capacitor first(C = 0.001), last(C = 0.002);
  Analog.Basic.Ground ground;
equation
  source.v = u;
  connect(source.n, ground.p);
  connect(source.p, along[1].p);
  for i in 1:n loop
    connect(along[i].n, across[i].p);
    connect(across[i].n, ground.p);
  end for;
  for i in 1:n-1 loop
    connect(along[i].n, along[i+1].p);
  end for;
  connect(first.p, along[1].n);
  connect(first.n, ground.p);
  connect(last.p, along[n].n);
  connect(last.n, ground.p);
end Resistors;
