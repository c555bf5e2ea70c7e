within Daest.Electrical.Analog.Interfaces;
partial model OnePort "Component with two pins and the same current through both"
  extends TwoPin;
  SI.Current i "Current flowing from pin p to pin n (= p.i)";
equation
  0 = p.i + n.i;
  i = p.i;
end OnePort;
