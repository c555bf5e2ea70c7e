within Daest.Effects.Thermal;
model RadiationLoss "Heat radiation into surroundings of constant temperature"
  extends Interfaces.PartialPort;
  parameter SI.Area Gr(min = 0) = 1 "Area times emissivity and view factor"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Temperature T_0(min = 233.15, max = 333.15) = 293.15 "Temperature of the surroundings"
    annotation(__Daest(estimate = true, role = "shape", grid = {293.15}));
protected
  constant Real sigma(unit = "W/(m2.K4)") = 5.670374419e-8 "Constant of Stefan and Boltzmann";
equation
  Q_flow = -Gr*sigma*(port.T^4 - T_0^4);
  annotation(
    __Daest(effect = true, attach = "connector", law = "Q_flow = -Gr*sigma*(port.T^4 - T_0^4)"),
    Documentation(info = "A hot body in a hall whose temperature nobody recorded. Near room temperature it is hardly told
from a loss in proportion to the difference."));
end RadiationLoss;
