within Daest.Effects.Electrical;
model VoltageRelaxation "Voltage drop that follows the current with delay, such as the polarisation of a battery"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter SI.Resistance R(min = 0) = 0.01 "Voltage drop per steady current"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-9) = 10 "Time constant"
    annotation(__Daest(estimate = true, role = "shape", of = "time", grid = {0.003, 0.01, 0.03, 0.1, 0.3}));
  SI.Current x(start = 0, stateSelect = StateSelect.prefer) "Current that the voltage has followed";
equation
  T*der(x) = i - x;
  v = R*x;
  annotation(
    __Daest(effect = true, attach = "series", law = "T*der(x) = i - x, v = R*x"),
    Documentation(info = "A resistor beside a capacitor in the current's way. Ions that diffuse and
double layers in batteries and cells do the same."));
end VoltageRelaxation;
