within Daest.Effects.Amounts;
model HiddenStore "Second store that exchanges with the first"
  extends Interfaces.PartialStore;
  parameter Real k(unit = "1/s", min = 0) = 0.01 "Share that goes over to the second store in a unit of time"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real T(unit = "s", min = 1e-9) = 1000 "Time constant of the second store"
    annotation(__Daest(estimate = true, role = "shape", of = "time", grid = {0.003, 0.01, 0.03, 0.1, 0.3}));
  Real z(start = 0, stateSelect = StateSelect.prefer) "Amount that would be in balance with the second store";
initial equation
  z = x;
equation
  T*der(z) = x - z;
  r = -k*(x - z);
  annotation(
    __Daest(effect = true, attach = "connector", law = "T*der(z) = x - z, r = -k*(x - z)"),
    Documentation(info = "Tissue behind the blood, a dead zone of a vessel, sediment, walls that take up and give back
later. In balance it holds k*T times as much as the first store. A refit finds what it begins with."));
end HiddenStore;
