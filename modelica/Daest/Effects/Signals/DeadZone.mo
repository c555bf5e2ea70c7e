within Daest.Effects.Signals;
block DeadZone "Small values of the signal are lost"
  extends Interfaces.SignalEffect;
  parameter Real width(min = 0) = 0.1 "Width of the dead zone from end to end"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "u"));
  parameter Real u_s(min = 1e-12) = 1e-3 "Range over which the kinks are rounded"
    annotation(__Daest(role = "sharpness", of = "u", grid = {0.01}, unit = "u"));
equation
  y = u + (sqrt((u - width/2)^2 + u_s^2) - sqrt((u + width/2)^2 + u_s^2))/2;
  annotation(
    __Daest(effect = true, attach = "signal", outside = "input",
      law = "y = u + (sqrt((u - width/2)^2 + u_s^2) - sqrt((u + width/2)^2 + u_s^2))/2"),
    Documentation(info = "y is 0 for |u| < width/2 and u -+ width/2 beyond: amplifiers with crossover,
valves with overlap, sensors with a threshold."));
end DeadZone;
