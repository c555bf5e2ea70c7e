within Daest.Units;
package SI "Quantities with their SI units"
  type Time = Real(final quantity = "Time", final unit = "s");
  type Frequency = Real(final quantity = "Frequency", final unit = "Hz");

  type Angle = Real(final quantity = "Angle", final unit = "rad", displayUnit = "deg");
  type AngularVelocity = Real(final quantity = "AngularVelocity", final unit = "rad/s");
  type AngularAcceleration = Real(final quantity = "AngularAcceleration", final unit = "rad/s2");
  type Torque = Real(final quantity = "Torque", final unit = "N.m");
  type Inertia = Real(final quantity = "MomentOfInertia", final unit = "kg.m2");
  type RotationalSpringConstant = Real(final quantity = "RotationalSpringConstant", final unit = "N.m/rad");
  type RotationalDampingConstant = Real(final quantity = "RotationalDampingConstant", final unit = "N.m.s/rad");

  type Length = Real(final quantity = "Length", final unit = "m");
  type Position = Real(final quantity = "Length", final unit = "m");
  type Velocity = Real(final quantity = "Velocity", final unit = "m/s");
  type Acceleration = Real(final quantity = "Acceleration", final unit = "m/s2");
  type Force = Real(final quantity = "Force", final unit = "N");
  type Mass = Real(final quantity = "Mass", final unit = "kg", min = 0);
  type TranslationalSpringConstant = Real(final quantity = "TranslationalSpringConstant", final unit = "N/m");
  type TranslationalDampingConstant = Real(final quantity = "TranslationalDampingConstant", final unit = "N.s/m");

  type Voltage = Real(final quantity = "ElectricPotential", final unit = "V");
  type ElectricPotential = Real(final quantity = "ElectricPotential", final unit = "V");
  type Current = Real(final quantity = "ElectricCurrent", final unit = "A");
  type Resistance = Real(final quantity = "Resistance", final unit = "Ohm");
  type Conductance = Real(final quantity = "Conductance", final unit = "S");
  type Inductance = Real(final quantity = "Inductance", final unit = "H");
  type MagneticFlux = Real(final quantity = "MagneticFlux", final unit = "Wb");
  type Capacitance = Real(final quantity = "Capacitance", final unit = "F", min = 0);
  type ElectricalTorqueConstant = Real(final quantity = "ElectricalTorqueConstant", final unit = "N.m/A");
  type ElectricalForceConstant = Real(final quantity = "ElectricalForceConstant", final unit = "N/A");

  type Temperature = Real(
    final quantity = "ThermodynamicTemperature", final unit = "K", min = 0, start = 293.15, nominal = 300,
    displayUnit = "degC");
  type TemperatureDifference = Real(final quantity = "ThermodynamicTemperature", final unit = "K");
  type TemperatureSlope = Real(final quantity = "TemperatureSlope", final unit = "K/s");
  type HeatFlowRate = Real(final quantity = "Power", final unit = "W");
  type HeatCapacity = Real(final quantity = "HeatCapacity", final unit = "J/K");
  type ThermalConductance = Real(final quantity = "ThermalConductance", final unit = "W/K");
  type ThermalResistance = Real(final quantity = "ThermalResistance", final unit = "K/W");

  type Pressure = Real(final quantity = "Pressure", final unit = "Pa", nominal = 1e5);
  type VolumeFlowRate = Real(final quantity = "VolumeFlowRate", final unit = "m3/s");
  type Area = Real(final quantity = "Area", final unit = "m2", min = 0);
  type Density = Real(final quantity = "Density", final unit = "kg/m3", min = 0);
  type HydraulicResistance = Real(final quantity = "HydraulicResistance", final unit = "Pa.s/m3");
end SI;
