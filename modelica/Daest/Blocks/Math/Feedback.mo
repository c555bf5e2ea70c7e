within Daest.Blocks.Math;
block Feedback "Difference of two signals"
  Daest.Blocks.Interfaces.RealInput u1 "Commanded signal";
  Daest.Blocks.Interfaces.RealInput u2 "Feedback signal";
  Daest.Blocks.Interfaces.RealOutput y "Output signal (= u1 - u2)";
equation
  y = u1 - u2;
end Feedback;
