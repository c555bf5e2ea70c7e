within Daest.Effects.Rotational;
model EndStop "Elastic stops that limit the motion"
  extends Interfaces.PartialRelative;
  parameter SI.RotationalSpringConstant c(min = 0) = 1 "Stiffness of the stops"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Angle phi_max = 0.1 "Where the upper stop begins"
    annotation(__Daest(estimate = true, role = "shape", of = "phi", grid = {0.8, 0.9, 0.95}));
  parameter SI.Angle phi_min = -0.1 "Where the lower stop begins"
    annotation(__Daest(estimate = true, role = "shape", of = "phi", grid = {-0.8, -0.9, -0.95}));
  parameter SI.Angle phi_s(min = 1e-12) = 1e-3 "Range over which contact begins"
    annotation(__Daest(role = "sharpness", of = "phi", grid = {0.01}));
equation
  tau = -c*(phi - phi_max + sqrt((phi - phi_max)^2 + phi_s^2))/2
    + c*(phi_min - phi + sqrt((phi_min - phi)^2 + phi_s^2))/2;
  annotation(
    __Daest(effect = true, attach = "connector", turns = 30,
      law = "tau = -c*(r(phi - phi_max) - r(phi_min - phi)), r(x) = (x + sqrt(x^2 + phi_s^2))/2"),
    Documentation(info = "Between phi_min and phi_max nothing happens; beyond, a spring pushes back.
The kinks are rounded over phi_s."));
end EndStop;
