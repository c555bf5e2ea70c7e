within Daest.Effects.Rotational;
model LearnedTorque "Torque on a shaft as a curve over a variable of the model"
  extends Daest.Effects.General.Interfaces.PartialLearnedLoad(y(each unit = "N.m"), load(unit = "N.m"));
  Daest.Mechanics.Rotational.Interfaces.Flange_b flange "Flange of the shaft";
equation
  flange.tau = -load;
  annotation(Documentation(info = "For an effect that no other class describes, as daest diagnose writes one:
straight lines between the knots, constant beyond the outermost ones unless the curve has a period. The
model supplies the variable, and the one whose sign counts, by a modifier:
LearnedTorque learned(x = rotor.phi, s = rotor.w, …)."));
end LearnedTorque;
