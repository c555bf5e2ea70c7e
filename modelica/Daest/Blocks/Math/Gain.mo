within Daest.Blocks.Math;
block Gain "Amplifier of a signal"
  parameter Real k(start = 1) "Gain: output over input";
  Daest.Blocks.Interfaces.RealInput u "Input signal";
  Daest.Blocks.Interfaces.RealOutput y "Output signal (= k*u)";
equation
  y = k*u;
end Gain;
