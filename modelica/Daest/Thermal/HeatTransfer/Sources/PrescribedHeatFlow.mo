within Daest.Thermal.HeatTransfer.Sources;
model PrescribedHeatFlow "Source whose heat flow is a signal"
  Daest.Blocks.Interfaces.RealInput Q_flow(unit = "W")
    "Heat flow rate into what is connected (= -port.Q_flow) as input signal";
  Interfaces.HeatPort_b port "Port that delivers the heat";
equation
  port.Q_flow = -Q_flow;
end PrescribedHeatFlow;
