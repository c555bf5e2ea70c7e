model QuarterCar "One wheel of a car: body, suspension, wheel and tyre on a moving road"
  import Daest.Units.SI;

  parameter SI.Mass m_body(min = 0, nominal = 100) = 300 "Sprung mass"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.Mass m_wheel(min = 0, nominal = 10) = 40 "Unsprung mass, weighed";
  parameter SI.TranslationalSpringConstant c(min = 0, nominal = 1e4) = 2e4 "Stiffness of the suspension"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.TranslationalDampingConstant d(min = 0, nominal = 1e3) = 1.5e3 "Damping of the suspension"
    annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.TranslationalSpringConstant c_tyre(min = 0, nominal = 1e5) = 2e5 "Stiffness of the tyre"
    annotation(__Daest(estimate = true, scale = "log"));

  Daest.Blocks.Interfaces.RealInput v_road(unit = "m/s", start = 0) "Vertical velocity of the road under the wheel";
  output SI.Acceleration a_body = body.a "Vertical acceleration of the body" annotation(__Daest(std = 0.05));
  output SI.Position deflection = suspension.s_rel "Deflection of the suspension from rest"
    annotation(__Daest(std = 5e-4));

  Daest.Mechanics.Translational.Sources.Speed road(exact = true) "Road";
  Daest.Mechanics.Translational.Components.Spring tyre(c = c_tyre) "Tyre";
  Daest.Mechanics.Translational.Components.Mass wheel(m = m_wheel) "Wheel";
  Daest.Mechanics.Translational.Components.SpringDamper suspension(c = c, d = d) "Suspension";
  Daest.Mechanics.Translational.Components.Mass body(m = m_body) "Quarter of the body";
  Daest.Noise.WhiteForce disturbance(intensity = 10) "Unmodelled force on the wheel";
equation
  connect(v_road, road.v_ref);
  connect(road.flange, tyre.flange_a);
  connect(tyre.flange_b, wheel.flange_a);
  connect(disturbance.flange, wheel.flange_a);
  connect(wheel.flange_b, suspension.flange_a);
  connect(suspension.flange_b, body.flange_a);
end QuarterCar;
