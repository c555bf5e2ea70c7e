model Zone "Heated room: capacities of room air and envelope, resistances to the envelope and to the ambient"
  import Daest.Units.SI;

  parameter SI.HeatCapacity Ci(min = 0, nominal = 1e6) = 2e6 "Heat capacity of the room air and what follows it"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.HeatCapacity Ce(min = 0, nominal = 1e7) = 2e7 "Heat capacity of the envelope"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.ThermalResistance Rie(min = 0, nominal = 1e-3) = 3e-3 "Resistance from the room air to the envelope"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.ThermalResistance Rea(min = 0, nominal = 1e-2) = 5e-3 "Resistance from the envelope to the ambient"
    annotation(__Daest(estimate = true, scale = "log"));

  Daest.Blocks.Interfaces.RealInput T_ambient(unit = "degC", start = 10) "Ambient temperature";
  Daest.Blocks.Interfaces.RealInput P_heater(unit = "W", start = 0) "Power of the heater";
  Daest.Blocks.Interfaces.RealOutput T_room(unit = "degC") "Temperature of the room air"
    annotation(__Daest(std = 0.05));

  Daest.Thermal.HeatTransfer.Components.HeatCapacitor room(C = Ci) "Room air";
  Daest.Thermal.HeatTransfer.Components.HeatCapacitor envelope(C = Ce) "Envelope";
  Daest.Thermal.HeatTransfer.Components.ThermalResistor inside(R = Rie) "Inner side of the envelope";
  Daest.Thermal.HeatTransfer.Components.ThermalResistor outside(R = Rea) "Outer side of the envelope";
  Daest.Thermal.HeatTransfer.Celsius.PrescribedTemperature ambient "Ambient";
  Daest.Thermal.HeatTransfer.Sources.PrescribedHeatFlow heater "Heater";
  Daest.Thermal.HeatTransfer.Celsius.TemperatureSensor thermometer "Thermometer in the room";
  Daest.Noise.WhiteHeatFlow gain(intensity = 1e6) "Unmodelled heat gain of the room air";
equation
  connect(T_ambient, ambient.T);
  connect(P_heater, heater.Q_flow);
  connect(heater.port, room.port);
  connect(gain.port, room.port);
  connect(room.port, inside.port_a);
  connect(inside.port_b, envelope.port);
  connect(envelope.port, outside.port_a);
  connect(outside.port_b, ambient.port);
  connect(room.port, thermometer.port);
  connect(thermometer.T, T_room);
end Zone;
