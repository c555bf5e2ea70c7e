within Daest.Mechanics.Translational.Sources;
model Force "Force on a flange as input signal"
  extends Interfaces.PartialElementaryOneFlangeAndSupport2;
  Daest.Blocks.Interfaces.RealInput f(unit = "N")
    "Force that accelerates the flange (= -flange.f) as input signal";
equation
  flange.f = -f;
end Force;
