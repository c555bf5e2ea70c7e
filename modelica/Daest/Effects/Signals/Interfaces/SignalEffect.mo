within Daest.Effects.Signals.Interfaces;
partial block SignalEffect "Block between a signal and its use"
  Daest.Blocks.Interfaces.RealInput u "Signal as it was";
  Daest.Blocks.Interfaces.RealOutput y "Signal with the effect";
end SignalEffect;
