within Daest.Thermal.HeatTransfer.Components;
model ThermalResistor "Transport of heat through a resistance"
  extends Interfaces.Element1D;
  parameter SI.ThermalResistance R(min = 0) "Thermal resistance (dT = R*Q_flow)";
equation
  dT = R*Q_flow;
end ThermalResistor;
