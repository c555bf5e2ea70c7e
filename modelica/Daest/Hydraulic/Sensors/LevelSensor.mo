within Daest.Hydraulic.Sensors;
model LevelSensor "Sensor of the level above a port at the bottom of a tank"
  parameter SI.Density rho = 998 "Density of the liquid";
  parameter SI.Acceleration g = Daest.Constants.g_n "Acceleration of gravity";
  Interfaces.Port_a port "Port whose pressure gives the level";
  Daest.Blocks.Interfaces.RealOutput level(unit = "m") "Level above the port (= port.p/(rho*g)) as output signal";
equation
  port.q = 0;
  rho*g*level = port.p;
end LevelSensor;
