within Daest.Electrical.Analog.Basic;
model Ground "Node of zero potential"
  Interfaces.Pin p "Pin that is held at zero potential";
equation
  p.v = 0;
end Ground;
