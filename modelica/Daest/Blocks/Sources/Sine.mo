within Daest.Blocks.Sources;
block Sine "Sine signal"
  import Daest.Units.SI;
  extends Daest.Blocks.Interfaces.SO;
  parameter Real amplitude = 1 "Amplitude of the sine";
  parameter SI.Frequency f(start = 1) "Frequency of the sine";
  parameter SI.Angle phase = 0 "Phase of the sine at time = 0";
  parameter Real offset = 0 "Mean of the signal";
equation
  y = offset + amplitude*sin(2*Daest.Constants.pi*f*time + phase);
end Sine;
