within Daest.Effects.Electrical;
model BrushVoltageDrop "Voltage that brushes or a diode pair keep"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter SI.Voltage V_b(min = 0) = 0.5 "Voltage drop"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Current i_s(min = 1e-12) = 0.01 "Current over which the sign changes"
    annotation(__Daest(role = "sharpness", of = "i", grid = {0.01}));
equation
  v = V_b*tanh(i/i_s);
  annotation(
    __Daest(effect = true, attach = "series", law = "v = V_b*tanh(i/i_s)"),
    Documentation(info = "Carbon brushes drop a voltage that hardly depends on the current."));
end BrushVoltageDrop;
