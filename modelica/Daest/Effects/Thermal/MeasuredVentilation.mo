within Daest.Effects.Thermal;
model MeasuredVentilation "Exchange of heat in proportion to a measured wind or fan speed"
  extends Daest.Thermal.HeatTransfer.Interfaces.Element1D;
  Daest.Blocks.Interfaces.RealInput u(unit = "m/s") "Measured speed of the air";
  parameter Real k(unit = "J/(m.K)", min = 0) = 1 "Conductance per speed of the air"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  Q_flow = k*u*dT;
  annotation(
    __Daest(effect = true, attach = "parallel", inputs = {"u"}, law = "Q_flow = k*u*dT"),
    Documentation(info = "Air that passes through leaks and openings carries heat from one body to the
other."));
end MeasuredVentilation;
