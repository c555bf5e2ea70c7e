within Daest.Effects.Translational;
model EndStop "Elastic stops that limit the motion"
  extends Interfaces.PartialRelative;
  parameter SI.TranslationalSpringConstant c(min = 0) = 1000 "Stiffness of the stops"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Position s_max = 0.01 "Where the upper stop begins"
    annotation(__Daest(estimate = true, role = "shape", of = "s", grid = {0.8, 0.9, 0.95}));
  parameter SI.Position s_min = -0.01 "Where the lower stop begins"
    annotation(__Daest(estimate = true, role = "shape", of = "s", grid = {-0.8, -0.9, -0.95}));
  parameter SI.Position s_s(min = 1e-12) = 1e-4 "Range over which contact begins"
    annotation(__Daest(role = "sharpness", of = "s", grid = {0.01}));
equation
  f = -c*(s - s_max + sqrt((s - s_max)^2 + s_s^2))/2
    + c*(s_min - s + sqrt((s_min - s)^2 + s_s^2))/2;
  annotation(
    __Daest(effect = true, attach = "connector",
      law = "f = -c*(r(s - s_max) - r(s_min - s)), r(x) = (x + sqrt(x^2 + s_s^2))/2"),
    Documentation(info = "Between s_min and s_max nothing happens; beyond, a spring pushes back. The
kinks are rounded over s_s."));
end EndStop;
