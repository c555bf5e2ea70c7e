within Daest.Terms;
model Voltage "Voltage in a mesh of known current"
  input SI.Current i "Current of the mesh";
  parameter Boolean is_used = false "Whether something is connected; else a wire";
  Daest.Electrical.Analog.Interfaces.PositivePin p "Where the current leaves for what is connected";
  Daest.Electrical.Analog.Interfaces.NegativePin n "Where it comes back";
  SI.Voltage total "Voltage over what is connected";
equation
  n.v = 0;
  total = p.v - n.v;
  if is_used then
    p.i = -i;
  else
    p.v = n.v;
  end if;
end Voltage;
