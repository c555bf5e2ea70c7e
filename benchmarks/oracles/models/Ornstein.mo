model Ornstein "Ornstein-Uhlenbeck process with a driven mean, one state"
  parameter Real theta(min = 0) = 1 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real mu = 1.5 annotation(__Daest(estimate = true));
  input Real u;
  input Real w annotation(__Daest(noise = true, intensity = 1));
  output Real y annotation(__Daest(std = 0.01));
  Real x(start = 1);
equation
  der(x) = theta*(mu + u - x) + w;
  y = x;
end Ornstein;
