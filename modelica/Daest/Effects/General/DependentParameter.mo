within Daest.Effects.General;
block DependentParameter "Parameter that changes with a variable of the model"
  extends Daest.Effects.Signals.Interfaces.SignalEffect;
  Daest.Blocks.Interfaces.RealInput z "Variable of the model";
  parameter Real r = 0.01 "Change for one unit of the variable, as a share of the value at z_0"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "1/z"));
  parameter Real z_0 = 0 "Variable at which the parameter has its value"
    annotation(__Daest(role = "shape", unit = "z"));
equation
  y = u*(1 + r*(z - z_0));
  annotation(
    __Daest(effect = true, attach = "parameter", inputs = {"z"}, law = "y = u*(1 + r*(z - z_0))"),
    Documentation(info = "A resistance that falls as it warms, a spring that stiffens, a capacity that grows
with the charge: the first term of any such dependence. The diagnosis looks for it where no effect of the
library explains what is missing."));
end DependentParameter;
