within Daest.Hydraulic.Components;
model LinearResistance "Line with laminar flow"
  extends Interfaces.PartialLine;
  parameter SI.HydraulicResistance R(min = 0) "Hydraulic resistance (dp = R*q)";
equation
  dp = R*q;
end LinearResistance;
