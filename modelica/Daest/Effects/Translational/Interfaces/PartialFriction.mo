within Daest.Effects.Translational.Interfaces;
partial model PartialFriction "Effect of the velocity of a body, against the housing or another body"
  extends PartialRelative;
  SI.Velocity v "Velocity with respect to the support (= der(s))";
equation
  v = der(s);
end PartialFriction;
