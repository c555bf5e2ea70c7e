within Daest.Units;
package SI "Quantities with their SI units"
  type Time = Real(final quantity = "Time", final unit = "s");
  type Duration = Real(final quantity = "Time", final unit = "s");
  type Period = Real(final quantity = "Time", final unit = "s");
  type Frequency = Real(final quantity = "Frequency", final unit = "Hz");
  type AngularFrequency = Real(final quantity = "AngularFrequency", final unit = "rad/s");
  type DimensionlessRatio = Real(final unit = "1");
  type Efficiency = Real(final quantity = "Efficiency", final unit = "1", min = 0);

  type Angle = Real(final quantity = "Angle", final unit = "rad", displayUnit = "deg");
  type AngularVelocity = Real(final quantity = "AngularVelocity", final unit = "rad/s");
  type AngularAcceleration = Real(final quantity = "AngularAcceleration", final unit = "rad/s2");
  type Torque = Real(final quantity = "Torque", final unit = "N.m");
  type Inertia = Real(final quantity = "MomentOfInertia", final unit = "kg.m2");
  type MomentOfInertia = Real(final quantity = "MomentOfInertia", final unit = "kg.m2");
  type AngularMomentum = Real(final quantity = "AngularMomentum", final unit = "kg.m2/s");
  type RotationalSpringConstant = Real(final quantity = "RotationalSpringConstant", final unit = "N.m/rad");
  type RotationalDampingConstant = Real(final quantity = "RotationalDampingConstant", final unit = "N.m.s/rad");

  type Length = Real(final quantity = "Length", final unit = "m");
  type Position = Real(final quantity = "Length", final unit = "m");
  type Distance = Real(final quantity = "Length", final unit = "m", min = 0);
  type Height = Real(final quantity = "Length", final unit = "m", min = 0);
  type Breadth = Real(final quantity = "Length", final unit = "m", min = 0);
  type Thickness = Real(final quantity = "Length", final unit = "m", min = 0);
  type Radius = Real(final quantity = "Length", final unit = "m", min = 0);
  type Diameter = Real(final quantity = "Length", final unit = "m", min = 0);
  type Velocity = Real(final quantity = "Velocity", final unit = "m/s");
  type Acceleration = Real(final quantity = "Acceleration", final unit = "m/s2");
  type Jerk = Real(final quantity = "Jerk", final unit = "m/s3");
  type Force = Real(final quantity = "Force", final unit = "N");
  type Mass = Real(final quantity = "Mass", final unit = "kg", min = 0);
  type Momentum = Real(final quantity = "Momentum", final unit = "kg.m/s");
  type Energy = Real(final quantity = "Energy", final unit = "J");
  type Work = Real(final quantity = "Work", final unit = "J");
  type Power = Real(final quantity = "Power", final unit = "W");
  type TranslationalSpringConstant = Real(final quantity = "TranslationalSpringConstant", final unit = "N/m");
  type TranslationalDampingConstant = Real(final quantity = "TranslationalDampingConstant", final unit = "N.s/m");

  type Voltage = Real(final quantity = "ElectricPotential", final unit = "V");
  type ElectricPotential = Real(final quantity = "ElectricPotential", final unit = "V");
  type PotentialDifference = Real(final quantity = "ElectricPotential", final unit = "V");
  type Current = Real(final quantity = "ElectricCurrent", final unit = "A");
  type ElectricCurrent = Real(final quantity = "ElectricCurrent", final unit = "A");
  type ElectricCharge = Real(final quantity = "ElectricCharge", final unit = "C");
  type Charge = Real(final quantity = "ElectricCharge", final unit = "C");
  type Resistance = Real(final quantity = "Resistance", final unit = "Ohm");
  type Impedance = Real(final quantity = "Resistance", final unit = "Ohm");
  type Resistivity = Real(final quantity = "Resistivity", final unit = "Ohm.m");
  type Conductance = Real(final quantity = "Conductance", final unit = "S");
  type Inductance = Real(final quantity = "Inductance", final unit = "H");
  type MagneticFlux = Real(final quantity = "MagneticFlux", final unit = "Wb");
  type MagneticFluxDensity = Real(final quantity = "MagneticFluxDensity", final unit = "T");
  type Capacitance = Real(final quantity = "Capacitance", final unit = "F", min = 0);
  type ElectricalTorqueConstant = Real(final quantity = "ElectricalTorqueConstant", final unit = "N.m/A");
  type ElectricalForceConstant = Real(final quantity = "ElectricalForceConstant", final unit = "N/A");

  type Temperature = Real(
    final quantity = "ThermodynamicTemperature", final unit = "K", min = 0, start = 293.15, nominal = 300,
    displayUnit = "degC");
  type TemperatureDifference = Real(final quantity = "ThermodynamicTemperature", final unit = "K");
  type TemperatureSlope = Real(final quantity = "TemperatureSlope", final unit = "K/s");
  type HeatFlowRate = Real(final quantity = "Power", final unit = "W");
  type Heat = Real(final quantity = "Energy", final unit = "J");
  type HeatFlux = Real(final quantity = "HeatFlux", final unit = "W/m2");
  type Irradiance = Real(final quantity = "Irradiance", final unit = "W/m2");
  type HeatCapacity = Real(final quantity = "HeatCapacity", final unit = "J/K");
  type SpecificHeatCapacity = Real(final quantity = "SpecificHeatCapacity", final unit = "J/(kg.K)");
  type ThermalConductance = Real(final quantity = "ThermalConductance", final unit = "W/K");
  type ThermalResistance = Real(final quantity = "ThermalResistance", final unit = "K/W");
  type ThermalConductivity = Real(final quantity = "ThermalConductivity", final unit = "W/(m.K)");
  type CoefficientOfHeatTransfer = Real(final quantity = "CoefficientOfHeatTransfer", final unit = "W/(m2.K)");
  type LinearTemperatureCoefficient = Real(final quantity = "LinearTemperatureCoefficient", final unit = "1/K");

  type Pressure = Real(final quantity = "Pressure", final unit = "Pa", nominal = 1e5);
  type AbsolutePressure = Real(final quantity = "Pressure", final unit = "Pa", min = 0, nominal = 1e5);
  type PressureDifference = Real(final quantity = "Pressure", final unit = "Pa", nominal = 1e5);
  type VolumeFlowRate = Real(final quantity = "VolumeFlowRate", final unit = "m3/s");
  type MassFlowRate = Real(final quantity = "MassFlowRate", final unit = "kg/s");
  type Volume = Real(final quantity = "Volume", final unit = "m3");
  type Area = Real(final quantity = "Area", final unit = "m2", min = 0);
  type Density = Real(final quantity = "Density", final unit = "kg/m3", min = 0);
  type DynamicViscosity = Real(final quantity = "DynamicViscosity", final unit = "Pa.s", min = 0);
  type KinematicViscosity = Real(final quantity = "KinematicViscosity", final unit = "m2/s", min = 0);
  type HydraulicResistance = Real(final quantity = "HydraulicResistance", final unit = "Pa.s/m3");
end SI;
