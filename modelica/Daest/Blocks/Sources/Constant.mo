within Daest.Blocks.Sources;
block Constant "Constant signal"
  extends Daest.Blocks.Interfaces.SO;
  parameter Real k(start = 1) "Value of the signal";
equation
  y = k;
end Constant;
