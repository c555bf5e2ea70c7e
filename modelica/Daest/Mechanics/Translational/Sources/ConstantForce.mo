within Daest.Mechanics.Translational.Sources;
model ConstantForce "Constant force on a flange"
  extends Interfaces.PartialElementaryOneFlangeAndSupport2;
  parameter SI.Force f_constant "Force that accelerates the flange (= -flange.f)";
equation
  flange.f = -f_constant;
end ConstantForce;
