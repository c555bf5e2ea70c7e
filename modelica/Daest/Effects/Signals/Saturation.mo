within Daest.Effects.Signals;
block Saturation "Large values of the signal are cut"
  extends Interfaces.SignalEffect;
  parameter Real share(unit = "1", min = 0, max = 1) = 1 "Share of the excess that is cut: 1 cuts all of it"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real limit(min = 0) = 1 "Magnitude from which the signal is cut"
    annotation(__Daest(estimate = true, role = "shape", of = "u", grid = {0.5, 0.7, 0.8, 0.9}, unit = "u"));
  parameter Real u_s(min = 1e-12) = 1e-3 "Range over which the kinks are rounded"
    annotation(__Daest(role = "sharpness", of = "u", grid = {0.01}, unit = "u"));
equation
  y = u - share*(2*u + sqrt((u - limit)^2 + u_s^2) - sqrt((u + limit)^2 + u_s^2))/2;
  annotation(
    __Daest(effect = true, attach = "signal", outside = "input",
      law = "y = u - share*(r(u - limit) - r(-u - limit)), r(x) = (x + sqrt(x^2 + u_s^2))/2"),
    Documentation(info = "Amplifiers at their supply voltage, sensors at the end of their range."));
end Saturation;
