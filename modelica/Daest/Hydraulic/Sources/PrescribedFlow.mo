within Daest.Hydraulic.Sources;
model PrescribedFlow "Pump whose volume flow is a signal"
  Daest.Blocks.Interfaces.RealInput q(unit = "m3/s")
    "Volume flow rate into what is connected (= -port.q) as input signal";
  Interfaces.Port_b port "Port that delivers the flow";
equation
  port.q = -q;
end PrescribedFlow;
