model Rig "A place for every effect: shaft, carriage, circuit, room, tank, salt and signals"
  import Daest.Units.SI;
  parameter SI.Inertia J(min = 0) = 0.5 "Inertia of the shaft";
  parameter SI.RotationalSpringConstant c(min = 0) = 8 "Stiffness of the shaft";
  parameter SI.Mass m = 2 "Mass of the carriage";

  Daest.Blocks.Interfaces.RealInput torque(unit = "N.m", start = 0) "Torque on the shaft";
  Daest.Blocks.Interfaces.RealInput voltage(unit = "V", start = 0) "Voltage of the circuit";
  Daest.Blocks.Interfaces.RealOutput angle(unit = "rad") "Angle of the load";
  output SI.Position way = carriage.s "Position of the carriage" annotation(__Daest(std = 1e-3));
  output SI.Current current(start = 0) = resistor.i "Current of the circuit";
  output SI.Pressure pressure "Pressure at the tank";

  Daest.Mechanics.Rotational.Sources.Torque drive "Drive";
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = J) "Rotor";
  Daest.Mechanics.Rotational.Components.SpringDamper shaft(c = c, d = 0.3) "Shaft";
  Daest.Mechanics.Rotational.Components.Inertia load(J = 1.5) "Load";
  Daest.Mechanics.Rotational.Sensors.AngleSensor sensor "Angle sensor";

  Daest.Mechanics.Translational.Components.Fixed wall "Wall";
  Daest.Mechanics.Translational.Components.Spring spring(c = 40) "Spring";
  Daest.Mechanics.Translational.Components.Mass carriage(m = m) "Carriage";
  Daest.Mechanics.Translational.Components.Damper damper(d = 3) "Damper";
  Daest.Mechanics.Translational.Components.Mass trailer(m = 4) "Trailer";

  Daest.Electrical.Analog.Sources.SignalVoltage source "Source";
  Daest.Electrical.Analog.Basic.Resistor resistor(R = 5) "Resistor";
  Daest.Electrical.Analog.Basic.Inductor coil(L = 0.2) "Coil";
  Daest.Electrical.Analog.Basic.Ground ground "Ground";

  Daest.Thermal.HeatTransfer.Components.HeatCapacitor room(C = 1000) "Room";
  Daest.Thermal.HeatTransfer.Components.ThermalResistor window(R = 0.1) "Window";
  Daest.Thermal.HeatTransfer.Sources.FixedTemperature outside(T = 280) "Outside";

  Daest.Hydraulic.Components.Tank tank(A = 0.01) "Tank";
  Daest.Hydraulic.Components.LinearResistance outlet(R = 2e7) "Outlet";
  Daest.Hydraulic.Sources.FixedPressure drain "Drain";
  Daest.Hydraulic.Sources.PrescribedFlow pump "Pump";
  Daest.Blocks.Sources.Constant supply(k = 1e-4) "Flow of the pump";
  Real salt(unit = "g/l", start = 1) "What the tank holds of salt";
  Real cell(unit = "V", start = 1) "Voltage of a cell that discharges";
equation
  connect(torque, drive.tau);
  connect(drive.flange, rotor.flange_a);
  connect(rotor.flange_b, shaft.flange_a);
  connect(shaft.flange_b, load.flange_a);
  connect(load.flange_b, sensor.flange);
  connect(sensor.phi, angle);
  connect(wall.flange, spring.flange_a);
  connect(spring.flange_b, carriage.flange_a);
  connect(carriage.flange_b, damper.flange_a);
  connect(damper.flange_b, trailer.flange_a);
  connect(voltage, source.v);
  connect(source.p, resistor.p);
  connect(resistor.n, coil.p);
  connect(coil.n, source.n);
  connect(source.n, ground.p);
  connect(room.port, window.port_a);
  connect(window.port_b, outside.port);
  connect(supply.y, pump.q);
  connect(pump.port, tank.inlet);
  connect(tank.outlet, outlet.port_a);
  connect(outlet.port_b, drain.port);
  pressure = tank.outlet.p;
  2*der(salt) = 0.3 - salt;
  4*der(cell) = 0.2 - cell;
end Rig;
