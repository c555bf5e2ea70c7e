model Emps "Electro-mechanical positioning system: one mass with viscous friction and a constant load"
  import Daest.Units.SI;

  parameter SI.Mass M(min = 0, nominal = 100) = 100 "Moving mass, with the motor reduced to the carriage"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.TranslationalDampingConstant Fv(min = 0, nominal = 100) = 200 "Viscous friction"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.Force offset(nominal = 10) = 0 "Constant load (force = M*a + Fv*v + offset)"
    annotation(__Daest(estimate = true));

  Daest.Blocks.Interfaces.RealInput force(unit = "N", start = 0) "Force of the motor on the carriage";
  Daest.Blocks.Interfaces.RealOutput position(unit = "m") "Position of the carriage"
    annotation(__Daest(std = 1e-5));

  Daest.Mechanics.Translational.Sources.Force motor "Force of the motor";
  Daest.Mechanics.Translational.Components.Mass carriage(m = M) "Carriage";
  Daest.Mechanics.Translational.Components.Damper friction(d = Fv) "Friction of the guide";
  Daest.Mechanics.Translational.Components.Fixed guide "Guide of the carriage";
  Daest.Mechanics.Translational.Sources.ConstantForce load(f_constant = -offset) "Constant load";
  Daest.Mechanics.Translational.Sensors.PositionSensor encoder "Encoder";
  Daest.Noise.WhiteForce disturbance(intensity = 1) "Unmodelled force on the carriage";
equation
  connect(force, motor.f);
  connect(motor.flange, carriage.flange_a);
  connect(guide.flange, friction.flange_a);
  connect(friction.flange_b, carriage.flange_b);
  connect(load.flange, carriage.flange_b);
  connect(disturbance.flange, carriage.flange_b);
  connect(encoder.flange, carriage.flange_b);
  connect(encoder.s, position);
end Emps;
