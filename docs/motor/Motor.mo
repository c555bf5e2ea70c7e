model Motor "A DC motor with a flywheel"
  parameter Daest.Units.SI.Resistance R = 2.4 "Armature resistance, measured with an ohmmeter";
  parameter Daest.Units.SI.ElectricalTorqueConstant k = 0.05 "Torque constant"
    annotation(__Daest(estimate = true));
  parameter Daest.Units.SI.Inertia J = 1e-4 "Rotor and flywheel" annotation(__Daest(estimate = true));
  parameter Daest.Units.SI.RotationalDampingConstant d = 1e-4 "Bearings" annotation(__Daest(estimate = true));
  Daest.Blocks.Interfaces.RealInput u(unit = "V") "Voltage of the amplifier";
  Daest.Blocks.Interfaces.RealOutput w(unit = "rad/s") "Speed";
  Daest.Electrical.Analog.Sources.SignalVoltage source;
  Daest.Electrical.Analog.Basic.Resistor resistor(R = R);
  Daest.Electrical.Analog.Basic.RotationalEMF emf(k = k);
  Daest.Electrical.Analog.Basic.Ground ground;
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = J);
  Daest.Mechanics.Rotational.Components.Damper bearing(d = d);
  Daest.Mechanics.Rotational.Components.Fixed housing;
  Daest.Mechanics.Rotational.Sensors.SpeedSensor tacho;
equation
  connect(u, source.v);
  connect(source.p, resistor.p);
  connect(resistor.n, emf.p);
  connect(emf.n, source.n);
  connect(emf.n, ground.p);
  connect(emf.flange, rotor.flange_a);
  connect(rotor.flange_b, bearing.flange_a);
  connect(bearing.flange_b, housing.flange);
  connect(rotor.flange_b, tacho.flange);
  connect(tacho.w, w);
end Motor;
