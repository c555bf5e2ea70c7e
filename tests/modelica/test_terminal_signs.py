"""Terminals: outputs in volts that an input in amperes moves at once."""

from pathlib import Path

import pytest

from daest.modelica.compile import compile_text
from daest.modelica.places.terminals import terminals

CELL = """model Cell
  parameter Real R(unit = "Ohm") = 0.02;
  parameter Real a(unit = "V") = 0.03;
  input Real i(unit = "A");
  input Real q(unit = "l/min");
  output Real u(unit = "V");
  Real soc(unit = "1", start = 0.5);
equation
  3600*der(soc) = i;
  u = 1.3 + 0.1*soc + {drop};
end Cell;
"""


@pytest.mark.parametrize(
    ("drop", "sign"),
    [
        ("R*i", 1.0),
        ("R*i + a*i/q", 1.0),  # a flow of electrolyte, without which it has no value
        ("(-R*(1 + 0.5*soc)*i)", -1.0),
        ("R*soc*i", None),  # nothing where that is zero: it may be anything
        ("a*(q - 1)*i", None),  # another way for another flow
        ("a*i*0", None),
    ],
)
def test_the_resistance_tells_which_way_the_current_flows(drop, sign):
    flat = compile_text(CELL.format(drop=drop).encode(), Path("Cell.mo"))
    found = [(one.name(flat), one.sign) for one in terminals(flat)]
    assert found == ([] if sign is None else [("u:i", sign)])
