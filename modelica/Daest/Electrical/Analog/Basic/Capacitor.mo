within Daest.Electrical.Analog.Basic;
model Capacitor "Ideal linear capacitor"
  extends Interfaces.OnePort(v(start = 0, stateSelect = StateSelect.prefer));
  parameter SI.Capacitance C(min = 0, start = 1) "Capacitance (i = C*der(v))";
equation
  i = C*der(v);
end Capacitor;
