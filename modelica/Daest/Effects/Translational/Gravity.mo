within Daest.Effects.Translational;
model Gravity "Weight of the body along the direction of motion"
  extends Interfaces.PartialFlange;
  parameter SI.Mass m(min = 0) = 0.1 "Mass that gravity pulls"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Angle slope(min = -7, max = 7) = Daest.Constants.pi/2
    "Slope of the positive direction, pi/2 if it points up"
    annotation(__Daest(role = "shape", grid = {1.5708}));
equation
  f = -m*Daest.Constants.g_n*sin(slope);
  annotation(
    __Daest(effect = true, attach = "connector", law = "f = -m*g_n*sin(slope)"),
    Documentation(info = "For a model that was written for a horizontal guide. Only the product
m*sin(slope) shows in data."));
end Gravity;
