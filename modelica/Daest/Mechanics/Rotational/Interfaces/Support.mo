within Daest.Mechanics.Rotational.Interfaces;
connector Support "Support of a component's housing"
  SI.Angle phi "Absolute angle of the support";
  flow SI.Torque tau "Reaction torque at the support: positive when it acts on the component";
end Support;
