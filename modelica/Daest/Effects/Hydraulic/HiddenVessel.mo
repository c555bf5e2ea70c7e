within Daest.Effects.Hydraulic;
model HiddenVessel "Second vessel that fills and empties with delay, behind a narrow passage"
  extends Interfaces.PartialPort;
  parameter Real G(unit = "m3/(s.Pa)", min = 0) = 1e-8 "Flow to the vessel per pressure drop"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-9) = 10 "Time constant of the vessel: its volume per pressure over G"
    annotation(__Daest(estimate = true, role = "shape", of = "time", grid = {0.003, 0.01, 0.03, 0.1, 0.3}));
  SI.Pressure z(start = 0, stateSelect = StateSelect.prefer)
    "Pressure over that in the vessel; zero after a long rest";
equation
  T*der(z) = T*der(p) - z;
  q = -G*z;
  annotation(
    __Daest(effect = true, attach = "connector", law = "T*der(z) = T*der(p) - z, q = -G*z"),
    Documentation(info = "A side chamber, a standpipe, a hose or a membrane that gives way, air that is trapped, ground
that takes up water. It holds G*T more volume per pressure. At the start it has the pressure of the port."));
end HiddenVessel;
