within Daest.Effects.General;
block ExponentialParameter "Parameter that goes with the exponential of a variable of the model"
  extends Daest.Effects.Signals.Interfaces.SignalEffect;
  Daest.Blocks.Interfaces.RealInput z "Variable of the model";
  parameter Real r = 0.01 "Change of the logarithm for one unit of the variable"
    annotation(__Daest(estimate = true, role = "size", null = 0, unit = "1/z"));
  parameter Real z_0 = 0 "Variable at which the parameter has its value"
    annotation(__Daest(role = "shape", unit = "z"));
equation
  y = u*exp(r*(z - z_0));
  annotation(
    __Daest(effect = true, attach = "parameter", inputs = {"z"}, law = "y = u*exp(r*(z - z_0))"),
    Documentation(info = "The viscosity of an oil, the rate of a reaction: what doubles with every so many
degrees. To first order it is DependentParameter, beside which the diagnosis asks for it."));
end ExponentialParameter;
