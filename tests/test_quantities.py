"""Units: conversion factors against their definitions in SI, and refusals."""

import math
import subprocess
import sys

import numpy as np
import pint
import pytest

from daest import quantities
from daest.errors import DataError
from daest.quantities import conversion, converts, dimensions, in_base_units, parse_unit, spoken_duration


@pytest.mark.parametrize(
    ("text", "factors"),
    [
        ("N.m", {"N": 1, "m": 1}),
        ("kg.m2", {"kg": 1, "m": 2}),
        ("N.m.s/rad", {"N": 1, "m": 1, "s": 1, "rad": -1}),
        ("W/(m2.K)", {"W": 1, "m": -2, "K": -1}),
        ("1/s", {"s": -1}),
        ("1", {}),
        ("", {}),
        ("s-1", {"s": -1}),
        ("m/s^2", {"m": 1, "s": -2}),
        ("m/s²", {"m": 1, "s": -2}),
        ("J/kg/K", {"J": 1, "kg": -1, "K": -1}),
        ("(N.m)/(rad/s)", {"N": 1, "m": 1, "rad": -1, "s": 1}),
        ("m.m-1", {}),
    ],
)
def test_modelica_unit_expressions(text, factors):
    assert parse_unit(text) == factors


@pytest.mark.parametrize(
    ("given", "wanted", "scale"),
    [
        ("deg", "rad", math.pi / 180),
        ("deg/s", "rad/s", math.pi / 180),
        ("rev/min", "rad/s", 2 * math.pi / 60),
        ("rpm", "rad/s", 2 * math.pi / 60),
        ("rad/s", "1/s", 1.0),
        ("mV", "V", 1e-3),
        ("kOhm", "Ohm", 1e3),
        ("g.cm2", "kg.m2", 1e-7),
        ("ms", "s", 1e-3),
        ("h", "s", 3600.0),
        ("%", "1", 0.01),
        ("kW.h", "J", 3.6e6),
        ("W/(m2.degC)", "W/(m2.K)", 1.0),
        ("N.m", "J", 1.0),
        ("mNm", "N.m", 1e-3),
        ("Nms/rad", "N.m.s/rad", 1.0),
        ("kgm²", "kg.m2", 1.0),
        ("bar", "Pa", 1e5),
        ("l/min", "m3/s", 1e-3 / 60),
        ("1/min", "rpm", 1.0),
        ("rpm", "1/min", 1.0),
        ("min-1", "rev/min", 1.0),
        ("Hz", "rpm", 60.0),
        ("rpm", "Hz", 1 / 60),
        ("Hz", "rev/s", 1.0),
    ],
)
def test_scale_is_the_definition(given, wanted, scale):
    found = conversion(given, wanted)
    assert found.scale == pytest.approx(scale, rel=1e-12)
    assert found.offset == 0.0


def test_temperatures_convert_with_offset():
    assert conversion("degC", "K")(np.array([0.0, 20.0])) == pytest.approx([273.15, 293.15], abs=1e-9)
    assert conversion("K", "degC")(np.array([273.15])) == pytest.approx([0.0], abs=1e-9)
    assert conversion("degF", "degC")(np.array([32.0, 212.0])) == pytest.approx([0.0, 100.0], abs=1e-9)


@pytest.mark.parametrize(
    ("given", "wanted"), [("V", "A"), ("N", "N.m"), ("rad", "m"), ("Hz", "rad/s"), ("1/min", "deg/s")]
)
def test_units_that_do_not_fit_name_both(given, wanted):
    with pytest.raises(DataError) as caught:
        conversion(given, wanted)
    assert caught.value.code == "unit-incompatible"
    assert f"'{given}'" in caught.value.what and f"'{wanted}'" in caught.value.what


@pytest.mark.parametrize("text", ["furlongs per", "N..m", "W/m2.K", "(N.m", "3", "wobble", "N m!"])
def test_unknown_units_are_refused(text):
    with pytest.raises(DataError) as caught:
        conversion(text, "V")
    assert caught.value.code == "unit-unknown"


def test_equal_units_need_no_pint():
    program = (
        "import sys; from daest.quantities import conversion as c;"
        "assert c('N.m', 'N.m').is_identity and c('N*m', 'm.N').is_identity; print('pint' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_turns_a_minute_are_not_guessed():
    for unit in ("U/min", "RPM", "rpm"):
        assert conversion(unit, "rad/s").scale == pytest.approx(2 * np.pi / 60, rel=1e-15)
    with pytest.raises(DataError) as raised:
        conversion("1/min", "rad/s")
    assert "rpm" in raised.value.remedy
    assert conversion("1/min", "1/s").scale == pytest.approx(1 / 60, rel=1e-15)


def test_g_is_gravity_where_an_acceleration_is_asked_for():
    assert conversion("g", "m/s2").scale == pytest.approx(9.80665)
    assert conversion("mg", "m/s2").scale == pytest.approx(9.80665e-3)
    assert conversion("g", "kg").scale == pytest.approx(1e-3)
    assert not converts("g", "m/s")


def test_units_as_loggers_write_them():
    written = {
        "Torr": ("Pa", 133.322),
        "mTorr": ("Pa", 0.133322),
        "PSI": ("Pa", 6894.76),
        "Volts": ("V", 1.0),
    }
    written |= {
        "Amps": ("A", 1.0),
        "Watt": ("W", 1.0),
        "cmH2O": ("Pa", 98.0665),
        "L/(s.cmH2O)": ("m3/(s.Pa)", 1.0197e-5),
    }
    for unit, (si, scale) in written.items():
        assert conversion(unit, si).scale == pytest.approx(scale, rel=1e-4), unit
    assert conversion("Celsius", "K").offset == pytest.approx(273.15)


def test_durations_are_told_in_units_that_suit_them():
    said = [spoken_duration(s) for s in (0.05, 60.0, 300.0, 1.8e4, 7200.0, 864000.0)]
    assert said == ["0.05 s", "60 s", "5 min", "5 h", "2 h", "10 d"]


def test_dimensions_of_known_units_are_those_of_pint() -> None:
    registry = pint.UnitRegistry()
    for symbol in quantities._KNOWN:
        known = {str(d): float(e) for d, e in registry.Quantity(1.0, symbol).dimensionality.items()}
        assert dimensions(symbol) == known, symbol
        name = "delta_degC" if symbol == "degC" else symbol
        assert in_base_units(symbol) == pytest.approx(registry.Quantity(1.0, name).to_base_units().magnitude)
    assert dimensions("W/(m2.K)") == {"[mass]": 1.0, "[time]": -3.0, "[temperature]": -1.0}
    assert dimensions("V.A/W") == {}


def test_c_and_f_are_degrees_where_a_temperature_is_wanted():
    assert conversion("C", "degC") == conversion("degC", "degC")
    assert conversion("C", "K") == conversion("degC", "K")
    assert conversion("F", "degC") == conversion("degF", "degC")
    assert conversion("mC", "C").scale == pytest.approx(1e-3)
    with pytest.raises(DataError):
        conversion("C", "W/K")
    with pytest.raises(DataError):
        conversion("degC", "C")
