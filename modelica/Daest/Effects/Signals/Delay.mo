within Daest.Effects.Signals;
block Delay "Dead time, as Pade's approximation of second order"
  extends Interfaces.SignalEffect;
  parameter SI.Time T(min = 0) = 0.01 "Dead time"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  Real x_1(start = 0) "First state of the approximation";
  Real x_2(start = 0) "Second state of the approximation";
equation
  T*der(x_1) = x_2;
  T*der(x_2) = u - 6*x_2 - 12*x_1;
  y = u - 12*x_2;
  annotation(
    __Daest(effect = true, attach = "signal", dynamic = true, law = "y(t) = u(t - T)"),
    Documentation(info = "Sampling, buses and transport. The transfer function is (1 - T*s/2 +
(T*s)^2/12)/(1 + T*s/2 + (T*s)^2/12), exact to 2 degrees of phase up to T*omega = 2."));
end Delay;
