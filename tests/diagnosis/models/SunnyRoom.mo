model SunnyRoom "Room behind whose window the sun shines, which the equations lack"
  parameter Real C(unit = "J/K", min = 0) = 6e5 "Of the air and the walls" annotation(__Daest(estimate = true));
  parameter Real G(unit = "W/K", min = 0) = 40 "To the outside" annotation(__Daest(estimate = true));
  input Real Q(unit = "W") "Of the heater";
  input Real Ta(unit = "degC") "Outside";
  input Real sun(unit = "W/m2") "On the window";
  output Real y(unit = "degC") annotation(__Daest(std = 0.05));
  Real T(unit = "degC", start = 18);
equation
  C*der(T) = Q - G*(T - Ta);
  y = T;
end SunnyRoom;
