within Daest.Thermal.HeatTransfer.Interfaces;
connector HeatPort_b "Right heat port"
  SI.Temperature T "Temperature at the port";
  flow SI.HeatFlowRate Q_flow "Heat flow rate into the component";
end HeatPort_b;
