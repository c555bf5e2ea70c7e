within Daest.Hydraulic.Sources;
model FixedPressure "Port of fixed pressure; the ambient by default"
  parameter SI.Pressure p = 0 "Fixed gauge pressure of the port";
  Interfaces.Port_b port "Port that is held";
equation
  port.p = p;
end FixedPressure;
