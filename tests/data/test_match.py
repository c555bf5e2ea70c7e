"""Proposals of columns for signals."""

import numpy as np
import pytest

from daest.data.match import match_columns
from daest.data.read import Signal
from daest.data.table import Column, Table, nearest, split_header, time_unit

NUMBERS = np.arange(3.0)


def table(*headers):
    parts = [split_header(header) for header in headers]
    return Table("run.csv", tuple(Column(name, unit, NUMBERS) for name, unit in parts), None)


def proposals(signals, *headers):
    return [(match.column, match.how) for match in match_columns(signals, table(*headers))]


def test_same_name_wins_over_unit():
    signals = [Signal("u", "V"), Signal("phi", "rad")]
    assert proposals(signals, "time", "phi", "u", "v [V]") == [("u", "name"), ("phi", "name")]


def test_case_trailing_unit_and_last_part_of_the_name():
    signals = [Signal("force", "N"), Signal("position", "m"), Signal("disc.phi", "rad")]
    found = proposals(signals, "time_s", "Force", "position_m", "phi")
    assert found == [("Force", "similar name"), ("position_m", "similar name"), ("phi", "similar name")]


def test_unit_only_where_it_is_unambiguous():
    assert proposals([Signal("force", "N")], "time", "motor_kN", "x_m") == [("motor_kN", "unit")]
    assert proposals([Signal("force", "N")], "time", "a [N]", "b [N]") == [(None, None)]
    two = [Signal("f1", "N"), Signal("f2", "N")]
    assert proposals(two, "time", "a [N]") == [(None, None), (None, None)]
    assert proposals([Signal("gain", "")], "time", "a [N]") == [(None, None)]


def test_name_inside_a_longer_one():
    signals = [Signal("goal", "rad"), Signal("enable", ""), Signal("q", "rad")]
    headers = ("time_s", "goal_position_rad", "torque_enable", "position_rad", "goal_speed_V")
    found = [("goal_position_rad", "part of its name"), ("torque_enable", "part of its name")]
    assert proposals(signals, *headers) == [*found, ("position_rad", "unit")]
    # Not a part of a word, and not where two have it.
    assert proposals([Signal("goal", "rad")], "time_s", "goals_rad", "x_deg") == [(None, None)]
    assert proposals([Signal("goal", "")], "time_s", "goal_a", "left_goal_rad")[0][0] == "goal_a"
    assert proposals([Signal("goal", "")], "time_s", "left_goal", "right_goal") == [(None, None)]


def test_time_is_no_signal():
    assert proposals([Signal("duration", "s")], "time [s]", "x") == [(None, None)]


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("u", "u", None),
        ("u [V]", "u", "V"),
        ("T[degC]", "T", "degC"),
        ("x[1]", "x[1]", None),
        ("x[1] [V]", "x[1]", "V"),
        ("x[2,1]", "x[2,1]", None),
        ("phi [1]", "phi", "1"),
        ("a b [m/s]", "a b", "m/s"),
    ],
)
def test_headers(header, name, unit):
    assert split_header(header) == (name, unit)


@pytest.mark.parametrize(
    ("header", "unit"),
    [("time", "s"), ("Time", "s"), ("time_ms", "ms"), ("time [min]", "min"), ("timer", None), ("t", None)],
)
def test_time_columns(header, unit):
    name, given = split_header(header)
    assert time_unit(Column(name, given, NUMBERS)) == unit


def test_nearest_names():
    assert nearest("omga", ["phi", "omega", "Omega2"]) == "did you mean omega, Omega2?"
    assert nearest("zzz", ["phi"]) == ""
