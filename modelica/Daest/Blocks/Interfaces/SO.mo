within Daest.Blocks.Interfaces;
partial block SO "Block with one output signal"
  RealOutput y "Output signal";
end SO;
