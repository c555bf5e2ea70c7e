within Daest.Mechanics.Rotational.Interfaces;
connector Flange_a "Left flange of a shaft"
  SI.Angle phi "Absolute angle of the flange";
  flow SI.Torque tau "Cut torque at the flange: positive when it acts on the component";
end Flange_a;
