within Daest.Effects.Signals;
block SecondOrderLag "Second-order lag"
  extends Interfaces.SignalEffect;
  parameter SI.Time T(min = 0) = 0.01 "How late a slow signal is"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter Real b(unit = "1", min = 1e-3) = 0.5 "Form: up to 1/4 two lags in a row, above that it swings"
    annotation(__Daest(estimate = true, role = "shape", grid = {0.25, 0.5}));
  Real r(start = 0) "Rate of y";
equation
  r = der(y);
  b*T^2*der(r) + T*r = u - y;
  annotation(
    __Daest(effect = true, attach = "signal", dynamic = true, rival = true, law = "b*T^2*der(r) + T*r = u - y, r = der(y)"),
    Documentation(info = "Filters of two poles, servo loops, flexible parts between drive and load."));
end SecondOrderLag;
