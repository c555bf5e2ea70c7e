within Daest.Electrical.Analog.Sources;
model ConstantCurrent "Source of constant current"
  extends Interfaces.OnePort;
  parameter SI.Current I(start = 1) "Value of the constant current (= p.i)";
equation
  i = I;
end ConstantCurrent;
