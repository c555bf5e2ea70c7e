within Daest.Thermal.HeatTransfer.Sources;
model FixedHeatFlow "Source of a fixed heat flow"
  parameter SI.HeatFlowRate Q_flow "Heat flow rate into what is connected (= -port.Q_flow)";
  Interfaces.HeatPort_b port "Port that delivers the heat";
equation
  port.Q_flow = -Q_flow;
end FixedHeatFlow;
