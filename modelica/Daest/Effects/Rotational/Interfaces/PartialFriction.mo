within Daest.Effects.Rotational.Interfaces;
partial model PartialFriction "Effect of the angular velocity of a shaft, against the housing or another shaft"
  extends PartialRelative;
  SI.AngularVelocity w "Angular velocity with respect to the support (= der(phi))";
equation
  w = der(phi);
end PartialFriction;
