within Daest.Mechanics.Translational.Interfaces;
connector Flange_a "Left flange of a sliding body"
  SI.Position s "Absolute position of the flange";
  flow SI.Force f "Cut force at the flange: positive when it acts on the component";
end Flange_a;
