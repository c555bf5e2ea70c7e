within Daest.Effects.Thermal;
model WallCapacity "Heat that the wall between two bodies stores"
  Daest.Thermal.HeatTransfer.Interfaces.HeatPort_a port_a "Body on one side";
  Daest.Thermal.HeatTransfer.Interfaces.HeatPort_b port_b "Body on the other side";
  parameter SI.ThermalConductance G(min = 0) = 1 "Heat capacity of the wall over its time constant"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-9) = 1000 "Time constant of the wall"
    annotation(__Daest(estimate = true, role = "shape", of = "time", grid = {0.003, 0.01, 0.03, 0.1, 0.3}));
  parameter Real share(unit = "1", min = 0, max = 1) = 0.5 "Of the temperature of port_b in that of the wall"
    annotation(__Daest(estimate = true, role = "shape", grid = {0.5}));
  SI.Temperature T_w(start = 293.15, stateSelect = StateSelect.prefer) "Temperature of the wall";
  SI.HeatFlowRate Q_flow "Heat that the wall takes up";
initial equation
  T_w = (1 - share)*port_a.T + share*port_b.T;
equation
  T*der(T_w) = (1 - share)*port_a.T + share*port_b.T - T_w;
  Q_flow = G*((1 - share)*port_a.T + share*port_b.T - T_w);
  port_a.Q_flow = (1 - share)*Q_flow;
  port_b.Q_flow = share*Q_flow;
  annotation(
    __Daest(effect = true, attach = "parallel",
      law = "T*der(T_w) = (1 - share)*T_a + share*T_b - T_w, Q_a = (1 - share)*G*T*der(T_w)"),
    Documentation(info = "The conductance of the wall stands in the model. What its heat capacity G*T takes up comes
from both sides, from each in proportion to how near it is; with share 0 it is an ExtraHeatCapacity at port_a."));
end WallCapacity;
