within Daest.Effects.Thermal;
model Radiation "Heat radiation between two bodies"
  extends Daest.Thermal.HeatTransfer.Interfaces.Element1D;
  parameter SI.Area Gr(min = 0) = 1 "Area times emissivity and view factor"
    annotation(__Daest(estimate = true, role = "size", null = 0));
protected
  constant Real sigma(unit = "W/(m2.K4)") = 5.670374419e-8 "Constant of Stefan and Boltzmann";
equation
  Q_flow = Gr*sigma*(port_a.T^4 - port_b.T^4);
  annotation(
    __Daest(effect = true, attach = "parallel", law = "Q_flow = Gr*sigma*(port_a.T^4 - port_b.T^4)"),
    Documentation(info = "sigma is the constant of Stefan and Boltzmann. At room temperature an area
of 1 m2 carries about 6 W/K."));
end Radiation;
