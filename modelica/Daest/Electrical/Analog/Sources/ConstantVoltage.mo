within Daest.Electrical.Analog.Sources;
model ConstantVoltage "Source of constant voltage"
  extends Interfaces.OnePort;
  parameter SI.Voltage V(start = 1) "Value of the constant voltage (= p.v - n.v)";
equation
  v = V;
end ConstantVoltage;
