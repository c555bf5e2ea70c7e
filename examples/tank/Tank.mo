model Tank "Two tanks in cascade: a pump fills the upper one, which drains into the lower one"
  import Daest.Units.SI;

  parameter SI.Area A(min = 0, nominal = 1e-2) = 1e-2 "Cross-section of each tank"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.HydraulicResistance R1(min = 0, nominal = 1e7) = 2e7 "Resistance of the upper outlet"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.HydraulicResistance R2(min = 0, nominal = 1e7) = 2e7 "Resistance of the lower outlet"
    annotation(__Daest(estimate = true, scale = "log"));

  Daest.Blocks.Interfaces.RealInput q(unit = "m3/s", start = 0) "Flow of the pump";
  Daest.Blocks.Interfaces.RealOutput level(unit = "m") "Level of the lower tank" annotation(__Daest(std = 1e-3));

  Daest.Hydraulic.Sources.PrescribedFlow pump "Pump";
  Daest.Hydraulic.Components.Tank upper(A = A) "Upper tank";
  Daest.Hydraulic.Components.LinearResistance drain(R = R1) "Outlet of the upper tank";
  Daest.Hydraulic.Components.Tank lower(A = A) "Lower tank";
  Daest.Hydraulic.Components.LinearResistance outlet(R = R2) "Outlet of the lower tank";
  Daest.Hydraulic.Sources.FixedPressure ambient "Reservoir below the tanks";
  Daest.Hydraulic.Sensors.LevelSensor sensor "Level sensor";
  Daest.Noise.WhiteVolumeFlow disturbance(intensity = 1e-12) "Unmodelled flow into the lower tank";
equation
  connect(q, pump.q);
  connect(pump.port, upper.inlet);
  connect(upper.outlet, drain.port_a);
  connect(drain.port_b, lower.inlet);
  connect(disturbance.port, lower.inlet);
  connect(lower.outlet, outlet.port_a);
  connect(outlet.port_b, ambient.port);
  connect(lower.outlet, sensor.port);
  connect(sensor.level, level);
end Tank;
