within Daest.Effects.Signals;
block RateLimit "The signal changes no faster than a limit"
  extends Interfaces.SignalEffect;
  parameter Real share(unit = "1", min = 0, max = 1) = 1 "Share of what the signal lags behind by: 1 is all of it"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real limit(min = 1e-12) = 1 "Fastest change of the signal, up and down"
    annotation(__Daest(estimate = true, role = "shape", of = "u/time", grid = {5, 15, 50, 150, 500}, unit = "u/s"));
  parameter SI.Time T(min = 1e-12) = 1e-3 "Time in which the follower is pushed along below the limit"
    annotation(__Daest(role = "shape", of = "sample", grid = {0.02}));
  Real x(start = 0, stateSelect = StateSelect.prefer) "Follower";
  Real z "How far the signal is ahead of it";
  Real h "Magnitude of that, rounded off below what lies between them at the limit";
initial equation
  x = u;
equation
  z = u - x;
  h = sqrt(sqrt(z^4 + (limit*T)^4));
  der(x) = limit*z/h;
  y = u - share*z*(z/h)^4;
  annotation(
    __Daest(effect = true, attach = "input",
      law = "y = u - share*z*(z/h)^4, der(x) = limit*z/h, z = u - x, h = (z^4 + (limit*T)^4)^(1/4)"),
    Documentation(info = "Valves, rudders and drives that are moved by a motor of limited speed, power that
is ramped: after a step the signal follows along a straight line."));
end RateLimit;
