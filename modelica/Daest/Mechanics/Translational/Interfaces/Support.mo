within Daest.Mechanics.Translational.Interfaces;
connector Support "Support of a component's housing"
  SI.Position s "Absolute position of the support";
  flow SI.Force f "Reaction force at the support: positive when it acts on the component";
end Support;
