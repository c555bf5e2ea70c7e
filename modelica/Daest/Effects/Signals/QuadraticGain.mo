within Daest.Effects.Signals;
block QuadraticGain "Gain that grows, or falls, with the magnitude of the signal"
  extends Interfaces.SignalEffect;
  parameter Real a = 0.1 "Relative rise of the gain per unit of the signal"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "1/u"));
  parameter Real u_s(min = 1e-12) = 1e-3 "Range over which the kink is rounded"
    annotation(__Daest(role = "sharpness", of = "u", grid = {0.01}, unit = "u"));
equation
  y = u + a*u*sqrt(u^2 + u_s^2);
  annotation(
    __Daest(effect = true, attach = "signal", law = "y = u + a*u*sqrt(u^2 + u_s^2)"),
    Documentation(info = "Propellers, whose thrust goes with the square of the command, and sensors and amplifiers
that are not linear: the first term of any odd characteristic that bends."));
end QuadraticGain;
