model Wall "Heat through a wall: two capacities, three resistances; heat flux on the inside measured"
  parameter Real C1(min = 0) = 80 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real C2(min = 0) = 60 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R1(min = 0) = 1.3 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R2(min = 0) = 1.6 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R3(min = 0) = 0.6 annotation(__Daest(estimate = true, scale = "log"));
  input Real Te;
  input Real Ti;
  output Real q annotation(__Daest(std = 0.02));
  Real T1(start = 13), T2(start = 25);
equation
  C1*der(T1) = (T2 - T1)/R2 + (Te - T1)/R1;
  C2*der(T2) = (Ti - T2)/R3 + (T1 - T2)/R2;
  q = (Ti - T2)/R3;
end Wall;
