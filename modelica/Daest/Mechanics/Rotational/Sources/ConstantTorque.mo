within Daest.Mechanics.Rotational.Sources;
model ConstantTorque "Constant torque on a flange"
  extends Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter SI.Torque tau_constant "Torque that accelerates the flange (= -flange.tau)";
equation
  flange.tau = -tau_constant;
end ConstantTorque;
