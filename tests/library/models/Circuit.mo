model Circuit "RC low pass, current divider and a plain resistor on one ground"
  Daest.Blocks.Interfaces.RealInput u(unit = "V", start = 0) "Voltage of the low pass";
  Daest.Blocks.Interfaces.RealInput j(unit = "A", start = 0) "Current of the divider";
  Daest.Blocks.Interfaces.RealOutput v_c(unit = "V") "Voltage of the capacitor";
  Daest.Blocks.Interfaces.RealOutput i_c(unit = "A") "Current into the capacitor";
  Daest.Blocks.Interfaces.RealOutput phi_c(unit = "V") "Potential of the capacitor's positive pin";
  output Real i_l(unit = "A") = inductor.i "Current through the inductor";
  output Real i_3(unit = "A") = plain.i "Current through the plain resistor";

  Daest.Electrical.Analog.Basic.Ground ground "Ground";
  Daest.Electrical.Analog.Sources.SignalVoltage source "Source of the low pass";
  Daest.Noise.WhiteVoltage white_voltage(intensity = 1) "Noise in series";
  Daest.Noise.ColouredVoltage coloured_voltage(std = 2, T = 5) "Noise in series";
  Daest.Electrical.Analog.Basic.Resistor resistor(R = 3) "Resistor of the low pass";
  Daest.Electrical.Analog.Sensors.CurrentSensor ammeter "Ammeter";
  Daest.Electrical.Analog.Basic.Capacitor capacitor(C = 0.5) "Capacitor of the low pass";
  Daest.Electrical.Analog.Sensors.VoltageSensor voltmeter "Voltmeter";
  Daest.Electrical.Analog.Sensors.PotentialSensor probe "Probe";

  Daest.Electrical.Analog.Sources.SignalCurrent injector "Current into the divider";
  Daest.Electrical.Analog.Sources.ConstantCurrent bias(I = 0.25) "Constant current into the divider";
  Daest.Noise.WhiteCurrent white_current(intensity = 1) "Noise out of the divider";
  Daest.Noise.ColouredCurrent coloured_current(std = 2, T = 5) "Noise out of the divider";
  Daest.Electrical.Analog.Basic.Resistor shunt(R = 4) "Shunt of the divider";
  Daest.Electrical.Analog.Basic.Inductor inductor(L = 0.7) "Inductor of the divider";

  Daest.Electrical.Analog.Sources.ConstantVoltage battery(V = 5) "Battery";
  Daest.Electrical.Analog.Basic.Resistor plain(R = 2) "Plain resistor";
equation
  connect(u, source.v);
  connect(source.p, white_voltage.p);
  connect(white_voltage.n, coloured_voltage.p);
  connect(coloured_voltage.n, resistor.p);
  connect(resistor.n, ammeter.p);
  connect(ammeter.n, capacitor.p);
  connect(capacitor.n, ground.p);
  connect(source.n, ground.p);
  connect(voltmeter.p, capacitor.p);
  connect(voltmeter.n, capacitor.n);
  connect(probe.p, capacitor.p);
  connect(voltmeter.v, v_c);
  connect(ammeter.i, i_c);
  connect(probe.phi, phi_c);
  connect(j, injector.i);
  connect(injector.p, ground.p);
  connect(bias.p, ground.p);
  connect(injector.n, shunt.p);
  connect(bias.n, shunt.p);
  connect(shunt.p, inductor.p);
  connect(shunt.p, white_current.p);
  connect(shunt.p, coloured_current.p);
  connect(shunt.n, ground.p);
  connect(inductor.n, ground.p);
  connect(white_current.n, ground.p);
  connect(coloured_current.n, ground.p);
  connect(battery.p, plain.p);
  connect(plain.n, ground.p);
  connect(battery.n, ground.p);
end Circuit;
