within Daest.Mechanics.Rotational.Sources;
model Torque "Torque on a flange as input signal"
  extends Interfaces.PartialElementaryOneFlangeAndSupport2;
  Daest.Blocks.Interfaces.RealInput tau(unit = "N.m")
    "Torque that accelerates the flange (= -flange.tau) as input signal";
equation
  flange.tau = -tau;
end Torque;
