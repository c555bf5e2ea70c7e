"""Units in FMI base units, against the SI brochure."""

import pytest

from daest.fmu.units import BaseUnit, base_unit, derivative_unit


@pytest.mark.parametrize(
    ("text", "exponents", "factor"),
    [
        ("N.m", {"kg": 1, "m": 2, "s": -2}, 1.0),
        ("V.s/rad", {"kg": 1, "m": 2, "s": -2, "A": -1, "rad": -1}, 1.0),
        ("W/(m2.K)", {"kg": 1, "s": -3, "K": -1}, 1.0),
        ("kg.m2", {"kg": 1, "m": 2}, 1.0),
        ("mm", {"m": 1}, 1e-3),
        ("km/h", {"m": 1, "s": -1}, 1 / 3.6),
        ("Ohm", {"kg": 1, "m": 2, "s": -3, "A": -2}, 1.0),
        ("deg/s", {"rad": 1, "s": -1}, 0.017453292519943295),
        ("mN.m", {"kg": 1, "m": 2, "s": -2}, 1e-3),
        ("min", {"s": 1}, 60.0),
        ("1", {}, 1.0),
    ],
)
def test_modelica_units_in_base_units(text, exponents, factor):
    found = base_unit(text)
    assert found.exponents == exponents
    assert found.factor == pytest.approx(factor, rel=1e-15)


def test_celsius_has_an_offset_alone_and_none_in_a_quotient():
    assert base_unit("degC") == BaseUnit({"K": 1}, offset=273.15)
    assert base_unit("W/degC").offset == 0.0


def test_unknown_symbols_have_no_base_unit():
    assert base_unit("furlong") is None
    assert base_unit("1//2") is None


@pytest.mark.parametrize(
    ("text", "order", "expected"),
    [
        ("rad", 1, "rad/s"),
        ("rad/s", 1, "rad/s2"),
        ("m", 2, "m/s2"),
        ("A.s", 1, "A"),
        ("", 1, ""),
        ("1", 1, "1/s"),
    ],
)
def test_unit_of_a_derivative(text, order, expected):
    assert derivative_unit(text, order) == expected
