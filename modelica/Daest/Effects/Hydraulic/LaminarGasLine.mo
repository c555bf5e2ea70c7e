within Daest.Effects.Hydraulic;
model LaminarGasLine "Laminar flow of a gas from one vessel to the next"
  extends Daest.Hydraulic.Interfaces.PartialLine;
  parameter Real b(unit = "m3/(s.Pa2)", min = 0) = 1e-13 "Flow per difference of the squares of the pressures"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  q = b*(port_a.p^2 - port_b.p^2);
  annotation(
    __Daest(effect = true, attach = "parallel", of_gas = true, law = "q = b*(port_a.p^2 - port_b.p^2)"),
    Documentation(info = "A capillary, a narrow slot or a porous wall: its conductance grows with the mean of the two
pressures. It is tried where masses flow, or pressure times volume: where volumes balance, it is a
liquid. Where pressures are told above that of the air, a line beside it, whose flow goes with the
drop, makes up for the zero."));
end LaminarGasLine;
