within Daest.Effects.Signals;
block RateLimit "The signal changes no faster than a limit"
  extends Interfaces.SignalEffect;
  parameter Real share(unit = "1", min = 0, max = 1) = 1 "Share of what is late that is lost: 1 loses all of it"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real limit(min = 1e-12) = 1 "Fastest change of the signal, up and down"
    annotation(__Daest(estimate = true, role = "shape", of = "u/time", grid = {5, 15, 50, 150, 500}, unit = "u/s"));
  parameter SI.Time T(min = 1e-12) = 1e-3 "Time in which the follower is pushed along below the limit"
    annotation(__Daest(role = "shape", of = "time", grid = {0.0004}, proof = 0.0001));
  Real x(start = 0, stateSelect = StateSelect.prefer) "Follower";
  Real z "How far the signal is ahead of it";
initial equation
  x = u;
equation
  der(x) = limit*z/sqrt(z^2 + (limit*T)^2);
  z = u - x;
  y = u - share*(z - T*der(x));
  annotation(
    __Daest(effect = true, attach = "input",
      law = "y = u - share*(z - T*der(x)), z = u - x, der(x) = limit*z/sqrt(z^2 + (limit*T)^2)"),
    Documentation(info = "Valves, rudders and drives that are moved by a motor of limited speed, power that
is ramped: after a step the signal follows along a straight line."));
end RateLimit;
