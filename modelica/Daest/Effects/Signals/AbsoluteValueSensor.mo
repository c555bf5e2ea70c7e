within Daest.Effects.Signals;
block AbsoluteValueSensor "Sensor that does not tell the sign"
  extends Interfaces.SignalEffect;
  parameter Real share(unit = "1", min = 0, max = 1) = 1 "1 if the sign is lost altogether"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real u_s(min = 1e-12) = 1e-3 "Range over which the kinks are rounded"
    annotation(__Daest(role = "sharpness", of = "u", grid = {0.01}, unit = "u"));
equation
  y = u + share*(sqrt(u^2 + u_s^2) - u);
  annotation(
    __Daest(effect = true, attach = "output", law = "y = u + share*(|u| - u)"),
    Documentation(info = "Sensors of magnitude, such as pulse counters. |u| is rounded as sqrt(u^2 +
u_s^2)."));
end AbsoluteValueSensor;
