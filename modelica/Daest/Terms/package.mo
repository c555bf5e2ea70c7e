within Daest;
package Terms "What is connected to a body that an equation describes, as a term of that equation"
  import Daest.Units.SI;
  annotation(Documentation(info = "A balance that is written as an equation has no connector. With
  Force v_term(s = s);
equation
  m*der(v) + v_term.total = F - d*v;
it has one: v_term.flange. Nothing changes as long as nothing is connected to it. The sum stands on the side of
the rate with its sign, as daest extend writes it. In a sum of voltages a Voltage takes the place of a wire, in one of
pressures a PressureDrop that of an open pipe:
  u = R*i + Ke*w + i_term.total;"));
end Terms;
