within Daest.Effects.Signals;
block OneSidedLimit "The signal is cut on one side"
  extends Interfaces.SignalEffect;
  parameter Real share(unit = "1", min = 0, max = 1) = 1 "Share of the excess that is cut: 1 cuts all of it"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real limit = 0 "Value from which the signal is cut"
    annotation(__Daest(estimate = true, role = "shape", of = "u",
      grid = {0, 0.25, -0.25, 0.5, -0.5, 0.75, -0.75}, unit = "u"));
  parameter Real side(unit = "1", min = -1, max = 1) = -1
    "Side that is cut: 1 above the limit, -1 below it"
    annotation(__Daest(role = "shape", grid = {-1, 1}));
  parameter Real u_s(min = 1e-12) = 1e-3 "Range over which the kink is rounded"
    annotation(__Daest(role = "sharpness", of = "u", grid = {0.01}, unit = "u"));
equation
  y = u - share*side*(side*(u - limit) + sqrt((side*(u - limit))^2 + u_s^2))/2;
  annotation(
    __Daest(effect = true, attach = "input",
      law = "y = u - share*side*r(side*(u - limit)), r(x) = (x + sqrt(x^2 + u_s^2))/2"),
    Documentation(info = "A heater does not cool, a pump does not draw, a valve closes no further than shut,
a supply with diodes drives and does not brake."));
end OneSidedLimit;
