"""The point that a nonlinear model is linearised at: algebraic unknowns agree with the start values."""

from pathlib import Path

import numpy as np
import pytest

from daest.modelica.compile import compile_text
from daest.systems.linear.linearize import linearize, operating_point
from daest.systems.linear.split import split
from daest.systems.linear.transfer import poles

WARM = b"""model Warm "a capacitor that discharges over a resistor whose resistance depends on a temperature"
  input Real u(start = 0);
  output Real y = i;
  Real x(start = 1, fixed = true);
  Real v, i, R, T;
equation
  der(x) = u - i;
  v = x;
  v = R*i;
  R = 2*(1 + 0.1*(T - 290));
  T = 300;
end Warm;
"""


def warm():
    return compile_text(WARM, Path("Warm.mo"))


def test_resistance_at_its_temperature():
    np.testing.assert_allclose(poles(split(linearize(warm()))), [-0.25])


@pytest.mark.parametrize(("at", "current"), [(None, 0.25), ({"x": 2.0}, 0.5), ({"i": 7.0, "x": 28.0}, 7.0)])
def test_values_that_are_given_are_kept(at, current):
    flat = warm()
    point = dict(zip([v.name for v in flat.unknowns], operating_point(flat, at).xi, strict=True))
    expected = {"x": 4 * current, "v": 4 * current, "i": current, "R": 4.0, "T": 300.0}
    assert {name: value for name, value in point.items() if name in expected} == pytest.approx(expected)


def test_a_held_value_goes_before_its_equation():
    flat = warm()
    point = operating_point(flat, {"T": 310.0})  # the model says 300
    assert point.xi[[v.name for v in flat.unknowns].index("T")] == 310.0
    assert point.xi[[v.name for v in flat.unknowns].index("R")] == pytest.approx(6.0)
