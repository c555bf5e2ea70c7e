model Ornstein2D "Ornstein-Uhlenbeck process with a driven mean, and a lag behind it"
  parameter Real theta(min = 0) = 5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real mu = 3 annotation(__Daest(estimate = true));
  parameter Real alpha(min = 0) = 2 annotation(__Daest(estimate = true, scale = "log"));
  input Real u;
  input Real w1 annotation(__Daest(noise = true, intensity = 1));
  input Real w2 annotation(__Daest(noise = true, intensity = 0.25));
  output Real y1 annotation(__Daest(std = 0.1));
  output Real y2 annotation(__Daest(std = 0.1));
  Real x1(start = 3), x2(start = 3);
equation
  der(x1) = theta*(mu + u - x1) + w1;
  der(x2) = alpha*(x1 - x2) + w2;
  y1 = x1;
  y2 = x2;
end Ornstein2D;
