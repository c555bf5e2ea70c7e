within Daest.Effects.Signals;
block Play "The signal follows only after a width has been passed"
  extends Interfaces.SignalEffect;
  parameter Real width(min = 0) = 0.1 "Width of the play from end to end"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "u"));
  parameter SI.Time T(min = 1e-12) = 1e-3 "Time in which the follower is pushed along"
    annotation(__Daest(role = "shape", of = "time", grid = {0.0004, 0.004}, proof = 0.0004));
  parameter Real u_s(min = 1e-12) = 1e-3 "Range over which the kinks are rounded"
    annotation(__Daest(role = "sharpness", of = "u", grid = {0.0002}, unit = "u"));
  Real x(start = 0, stateSelect = StateSelect.prefer) "Follower";
  Real z "How far the signal is ahead of it";
initial equation
  x = u;
equation
  T*der(x) = y - x;
  z = u - x;
  y = u - width*z/(sqrt((z - width/2)^2 + u_s^2) + sqrt((z + width/2)^2 + u_s^2));
  annotation(
    __Daest(effect = true, attach = "signal",
      law = "T*der(x) = y - x, y = u - width*z/(a(z - width/2) + a(z + width/2)), z = u - x, a(z) = |z| above u_s"),
    Documentation(info = "Gears between a shaft and its sensor, valves and levers that stick: after a change
of direction the signal rests until the width has been passed."));
end Play;
