model VoiceCoil "Voice coil in a housing that slides with friction"
  Daest.Blocks.Interfaces.RealInput u(unit = "V", start = 0) "Voltage of the coil";
  output Real v_coil(unit = "m/s") = coil.v "Velocity of the coil";
  output Real v_housing(unit = "m/s") = housing.v "Velocity of the housing";

  Daest.Electrical.Analog.Basic.Ground ground "Ground";
  Daest.Electrical.Analog.Sources.SignalVoltage source "Source";
  Daest.Electrical.Analog.Basic.Resistor resistor(R = 2) "Winding";
  Daest.Electrical.Analog.Basic.TranslationalEMF emf(k = 3, useSupport = true) "Air gap";
  Daest.Mechanics.Translational.Components.Mass coil(m = 0.5) "Coil";
  Daest.Mechanics.Translational.Components.Mass housing(m = 4) "Housing";
  Daest.Mechanics.Translational.Components.Damper friction(d = 6) "Friction of the housing";
  Daest.Mechanics.Translational.Components.Fixed frame "Frame";
equation
  connect(u, source.v);
  connect(source.p, resistor.p);
  connect(resistor.n, emf.p);
  connect(emf.n, ground.p);
  connect(source.n, ground.p);
  connect(emf.flange, coil.flange_a);
  connect(emf.support, housing.flange_a);
  connect(housing.flange_b, friction.flange_a);
  connect(friction.flange_b, frame.flange);
end VoiceCoil;
