within Daest.Effects.Electrical;
model TemperatureDependentResistance "Resistance that grows as the current heats the winding"
  extends Daest.Electrical.Analog.Interfaces.OnePort;
  parameter SI.Resistance r(min = 0) = 0.1 "Growth of the resistance in the steady state at current i_n"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Time T(min = 1e-3) = 60 "Time constant of the heating"
    annotation(__Daest(estimate = true, role = "shape", grid = {3, 10, 30, 100, 300}));
  parameter SI.Current i_n(min = 1e-12) = 1 "Current at which the growth is r"
    annotation(__Daest(role = "shape", of = "i", grid = {1}));
  Real x(unit = "1", start = 0, stateSelect = StateSelect.prefer) "Heating over that at current i_n";
equation
  T*der(x) = (i/i_n)^2 - x;
  v = r*x*i;
  annotation(
    __Daest(effect = true, attach = "series", law = "T*der(x) = (i/i_n)^2 - x, v = r*x*i"),
    Documentation(info = "Copper gains 0.39 % of resistance per kelvin."));
end TemperatureDependentResistance;
