model StirredVessel "Vessel that is heated and stirred, in a jacket"
  parameter Real C(unit = "J/K", min = 0) = 4000 "Heat capacity"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter Real G(unit = "W/K", min = 0) = 5 "Conductance of the wall"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter Real Tj(unit = "degC") = 18 "Temperature of the jacket" annotation(__Daest(estimate = true));
  input Real P(unit = "W", start = 0) "Heating";
  input Real n(unit = "1/min", start = 200) "Speed of the stirrer";
  output Real T(unit = "degC", start = 35) "Temperature" annotation(__Daest(std = 0.05));
equation
  C*der(T) = P - G*(T - Tj);
end StirredVessel;
