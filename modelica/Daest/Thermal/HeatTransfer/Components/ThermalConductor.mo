within Daest.Thermal.HeatTransfer.Components;
model ThermalConductor "Transport of heat through a conductance"
  extends Interfaces.Element1D;
  parameter SI.ThermalConductance G(min = 0) "Thermal conductance (Q_flow = G*dT)";
equation
  Q_flow = G*dT;
end ThermalConductor;
