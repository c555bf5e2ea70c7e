within Daest.Effects.Thermal;
model Conduction "Bridge of heat between two bodies"
  extends Daest.Thermal.HeatTransfer.Interfaces.Element1D;
  parameter SI.ThermalConductance G(min = 0) = 1 "Thermal conductance"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  Q_flow = G*dT;
  annotation(
    __Daest(effect = true, attach = "parallel", law = "Q_flow = G*dT"),
    Documentation(info = "A path of heat that the model leaves out."));
end Conduction;
