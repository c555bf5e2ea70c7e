"""Parameters that no recording tells apart."""

from pathlib import Path

import pytest

from daest.modelica.compile import compile_text
from daest.systems.reduction.known_together import told_apart
from daest.systems.reduction.reduce import reduce_index

BODY = """model Body
  parameter Real m = 2;
  parameter Real g = 9.8;
  parameter Real d = 0.1;
  parameter Real k = 3;
  input Real F;
  output Real v;
equation
  m*der(v) = LAW;
end Body;
"""


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        ("m*g - d*v", "mgk"),  # falls: d/m is all that is known; k stands nowhere and is left alone
        ("F - m*g - d*v", "mgd"),
        ("k*F - d*v", "mgd"),  # a gain of the force is the inverse of the others
        ("F - d*v*abs(v) - k*sqrt(v)", "mgdk"),  # no root of what is below zero
    ],
)
def test_of_those_that_the_equations_know_only_together_the_first_are_kept(law, expected):
    model = reduce_index(compile_text(BODY.replace("LAW", law).encode(), Path("Body.mo")))
    names = "mgdk" if "k" in law or expected.endswith("k") else "mgd"
    assert "".join(told_apart(model, tuple(names))) == expected


def test_nothing_is_left_out_of_more_than_can_be_looked_at():
    model = reduce_index(compile_text(BODY.replace("LAW", "m*g - d*v").encode(), Path("Body.mo")))
    assert told_apart(model, ("m",)) == ("m",)
    assert told_apart(model, ("m", "d") * 26) == ("m", "d") * 26
