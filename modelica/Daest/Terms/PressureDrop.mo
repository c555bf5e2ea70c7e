within Daest.Terms;
model PressureDrop "Pressure drop along a line of known flow"
  input SI.VolumeFlowRate q "Flow through the line";
  parameter Boolean is_used = false "Whether something is connected; else an open pipe";
  Daest.Hydraulic.Interfaces.Port_a port_a "Where the liquid leaves for what is connected";
  Daest.Hydraulic.Interfaces.Port_b port_b "Where it comes back";
  SI.Pressure total "Pressure drop over what is connected";
equation
  port_b.p = 0;
  total = port_a.p - port_b.p;
  if is_used then
    port_a.q = -q;
  else
    port_a.p = port_b.p;
  end if;
end PressureDrop;
