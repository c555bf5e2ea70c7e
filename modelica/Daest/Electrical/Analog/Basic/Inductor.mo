within Daest.Electrical.Analog.Basic;
model Inductor "Ideal linear inductor"
  extends Interfaces.OnePort(i(start = 0, stateSelect = StateSelect.prefer));
  parameter SI.Inductance L(min = 0, start = 1) "Inductance (v = L*der(i))";
equation
  L*der(i) = v;
end Inductor;
