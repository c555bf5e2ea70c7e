within Daest.Electrical.Analog.Basic;
model Resistor "Ideal linear resistor"
  extends Interfaces.OnePort;
  parameter SI.Resistance R(min = 0, start = 1) "Resistance (v = R*i)";
equation
  v = R*i;
end Resistor;
