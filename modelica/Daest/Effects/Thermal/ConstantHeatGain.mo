within Daest.Effects.Thermal;
model ConstantHeatGain "Constant flow of heat into a body"
  extends Interfaces.PartialPort;
  parameter SI.HeatFlowRate Q_0 = 100 "Heat that the body gains"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  Q_flow = Q_0;
  annotation(
    __Daest(effect = true, attach = "connector", law = "Q_flow = Q_0"),
    Documentation(info = "People, lights and machines that nobody recorded."));
end ConstantHeatGain;
