within Daest.Hydraulic.Components;
model Tank "Open tank with vertical walls: inlet above the surface, outlet at the bottom"
  parameter SI.Area A "Cross-section of the tank";
  parameter SI.Density rho = 998 "Density of the liquid";
  parameter SI.Acceleration g = Daest.Constants.g_n "Acceleration of gravity";
  SI.Length level(start = 0, min = 0, stateSelect = StateSelect.prefer) "Level of the liquid above the bottom";
  Interfaces.Port_a inlet "Port above the surface, at ambient pressure";
  Interfaces.Port_b outlet "Port at the bottom";
equation
  inlet.p = 0;
  outlet.p = rho*g*level;
  A*der(level) = inlet.q + outlet.q;
end Tank;
