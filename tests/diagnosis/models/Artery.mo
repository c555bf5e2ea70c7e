model Artery "Two elastic vessels behind a heart"
  parameter Real C1(min = 0) = 1.1 annotation(__Daest(estimate = true));
  parameter Real C2(min = 0) = 1.7 annotation(__Daest(estimate = true));
  parameter Real R1(min = 0) = 0.11 annotation(__Daest(estimate = true));
  parameter Real R2(min = 0) = 0.95 annotation(__Daest(estimate = true));
  input Real q "Flow";
  Real p1(start = 80) "Pressure", p2(start = 80) "Pressure";
  output Real aorta = p1, arteries = p2;
equation
  C1*der(p1) = q - (p1 - p2)/R1;
  C2*der(p2) = (p1 - p2)/R1 - p2/R2;
end Artery;
