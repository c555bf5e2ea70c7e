within Daest.Hydraulic.Interfaces;
connector Port_b "Right hydraulic port"
  SI.Pressure p "Gauge pressure at the port";
  flow SI.VolumeFlowRate q "Volume flow rate into the component";
end Port_b;
