within Daest.Blocks.Interfaces;
partial block SISO "Block with one input and one output signal"
  RealInput u "Input signal";
  RealOutput y "Output signal";
end SISO;
