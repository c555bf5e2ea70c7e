"""Proposals of columns for signals."""

import numpy as np
import pytest

from daest.data.match import clock_findings, match_columns, named_units, propose_time, unitless_findings
from daest.data.read import Signal, with_units
from daest.data.table import (
    Column,
    Table,
    column_unit,
    in_seconds,
    split_header,
    time_unit,
    told_unit,
    unit_findings,
)
from daest.data.table import stem as stem_of
from daest.errors import DataError

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


@pytest.mark.parametrize("form", ["T{} [kN]", "T_{} [kN]", "t {}", "T{}_kN"])
def test_elements_of_arrays_as_tables_write_them(form):
    signals = [Signal(f"T[{i}]", "kN") for i in (1, 2, 11)]
    headers = [form.format(i) for i in (11, 1, 2)]
    found = match_columns(signals, table("time", *headers))
    columns = [table(header).columns[0].name for header in headers]
    assert [match.column for match in found] == [columns[1], columns[2], columns[0]]
    assert {match.how for match in found} == {"similar name"}


def test_elements_of_arrays_of_components_and_matrices():
    signals = [Signal("cell[1].T", "K"), Signal("cell[2].T", "K"), Signal("k[1,2]", "")]
    found = proposals(signals, "time", "k12", "cell2_T", "cell1.T")
    assert found == [("cell1.T", "similar name"), ("cell2_T", "similar name"), ("k12", "similar name")]


def test_a_signal_that_ends_with_its_unit_is_a_column_without():
    signals = [Signal("p1_bar", "bar"), Signal("p2_bar", "bar"), Signal("q_deg", "deg")]
    found = proposals(signals, "time", "p2 / bar", "p1 [bar]", "q [deg/s]", "x [bar]")
    assert found == [("p1", "similar name"), ("p2", "similar name"), (None, None)]


def test_dates_are_the_time_beside_what_increases_too():
    stamps = [f"21.11.2026 08:15:0{second}" for second in range(3)]
    dates = Column("Datum Uhrzeit", None, np.full(3, np.nan), texts=tuple(enumerate(stamps)))
    recording = Table("run.csv", (dates, Column("energy", "J", NUMBERS)), None)
    assert propose_time(Table("run.csv", (dates, Column("T", "degC", NUMBERS)), None)) == "Datum Uhrzeit"
    assert propose_time(recording) == "Datum Uhrzeit"


def test_unit_only_where_it_is_unambiguous():
    assert proposals([Signal("force", "N")], "time", "motor_kN", "x_m") == [("motor_kN", "unit")]
    assert proposals([Signal("force", "N")], "time", "a [N]", "b [N]") == [(None, None)]
    two = [Signal("f1", "N"), Signal("f2", "N")]
    assert proposals(two, "time", "a [N]") == [(None, None), (None, None)]
    assert proposals([Signal("gain", "")], "time", "a [N]", "b [N]") == [(None, None)]


def test_the_one_column_left_is_for_the_one_signal_left():
    left = "being the only one left"
    assert proposals([Signal("gain", "")], "time", "a [N]") == [("a", left)]
    assert proposals([Signal("u", "V"), Signal("w", "rad/s")], "time", "u", "ch2") == [
        ("u", "name"),
        ("ch2", left),
    ]
    assert proposals([Signal("speed", "rad/s")], "time", "ch2 [V]") == [(None, None)]
    assert proposals([Signal("a", ""), Signal("b", "")], "time", "ch2") == [(None, None), (None, None)]


def clock(name, values, unit=None):
    return Column(name, unit, np.asarray(values, dtype=float))


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        (clock("t_ms", [0, 5, 10]), "ms"),
        (clock("t", [0, 5, 10], "us"), "us"),
        (clock("elapsed_min", [0, 5, 10]), "min"),
        (clock("t", [1_700_000_000_000, 1_700_000_000_005]), "ms"),
        (clock("t", [1_700_000_000, 1_700_000_060]), "s"),
        (clock("time", [1.7e18, 1.7e18 + 1e9]), "ns"),
        (clock("t", [0, 5, 10]), None),
        (clock("reached_m", [0, 5, 10]), None),
    ],
)
def test_what_tells_the_unit_of_the_time(column, unit):
    assert told_unit(column) == unit
    factor = {"s": 1.0, "us": 1e-6, "ms": 1e-3, "ns": 1e-9, "min": 60.0, None: 1.0}[unit]
    step = np.diff(column.values)[0]
    assert np.diff(in_seconds(column))[0] == pytest.approx(factor * step, rel=1e-12)


def test_whole_numbers_without_a_unit_are_doubted():
    assert [f.level for f in unit_findings(clock("t", [0, 5, 10]))] == ["warning"]
    assert [f.level for f in unit_findings(clock("time", [0, 600, 1200]))] == ["note"]
    assert not unit_findings(clock("t", [0, 0.5, 1.0]))
    assert not unit_findings(clock("t_ms", [0, 5, 10]))


def test_a_time_that_tells_its_unit_is_noted_where_the_model_counts_hours():
    found = clock_findings(table("time [min]", "x"), "h")
    assert [(f.code, f.level) for f in found] == [("check-model-clock", "note")] and "read in h," in found[
        0
    ].text
    assert not clock_findings(table("time", "x"), "h") and not clock_findings(table("time [h]", "x"), "s")


def test_a_column_with_a_unit_for_a_signal_without_is_warned_of():
    signals = [Signal("pos", "", "x"), Signal("u", "V"), Signal("ratio", "")]
    found = unitless_findings(table("time", "x [mm]", "u [mV]", "ratio [1]"), signals)
    assert [(f.column, f.code) for f in found] == [("x", "check-unit-unknown")]


@pytest.mark.parametrize(
    ("name", "unit", "stem"),
    [
        ("speed_rad_s", "rad/s", "speed"),
        ("flow_m3_h", "m3/h", "flow"),
        ("a_m_s2", "m/s2", "a"),
        ("speed_rad_per_s", "rad/s", "speed"),
        ("motor_force_N", "N", "motor_force"),
        ("delay_ms_s", "s", "delay_ms"),
        ("pos_x_s", "s", "pos_x"),
        ("T_mean", "", "T_mean"),
    ],
)
def test_units_at_the_end_of_a_name(name, unit, stem):
    column = Column(name, None, NUMBERS)
    assert (column_unit(column), stem_of(column)) == (unit, stem)


def test_a_speed_is_found_by_its_name_and_unit():
    signals = [Signal("angle", "rad"), Signal("speed", "rad/s")]
    found = [("angle_rad", "similar name"), ("speed_rad_s", "similar name")]
    assert proposals(signals, "time_s", "angle_rad", "speed_rad_s") == found


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
    assert proposals([Signal("duration", "s")], "time [s]", "x [m]") == [(None, None)]


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


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("U/V", "U", "V"),
        ("n (U/min)", "n", "U/min"),
        ("n / min⁻¹", "n", "min⁻¹"),
        ("t in s", "t", "s"),
        ("t/ms", "t", "ms"),
        ("v [m/s]", "v", "m/s"),
        ("v/(m/s)", "v", "m/s"),
        ("v / m/s", "v", "m/s"),
        ("Kraft F in kN", "Kraft F", "kN"),
        ("M / Nm", "M", "Nm"),
        ("ϑ_1/°C", "ϑ_1", "°C"),
        ("flow l/min", "flow", "l/min"),  # no flow l in minutes
        ("Drehzahl 1/min", "Drehzahl", "1/min"),
        ("acc of body m/s2", "acc of body", "m/s2"),
        ("Zeit t/s", "Zeit t", "s"),
        ("Phase A/V", "Phase A", "V"),
        ("m/s", "m/s", None),  # the unit of a rate, no mass in seconds
        ("U/min", "U/min", None),
        ("on/off", "on/off", None),
        ("a/b", "a/b", None),
        ("step in a row", "step in a row", None),
    ],
)
def test_headers_as_din_writes_them(header, name, unit):
    assert split_header(header) == (name, unit)
    given = table(header)
    assert given.find(header) is given.columns[0] is given.find(name)


def test_turns_in_a_minute_are_proposed_as_rpm():
    din = table("t in s", "U/V", "n in 1/min", "M / Nm")
    signals = [Signal("u", "V"), Signal("w", "rad/s"), Signal("tau", "N.m")]
    matches = match_columns(signals, din)
    assert [match.column for match in matches] == ["U", "n", "M"]
    assert named_units(matches, din) == {"n": "rpm"}
    assert named_units(match_columns([Signal("rate", "deg/s")], din), din) == {"n": "rpm"}
    assert named_units(match_columns([Signal("rate", "rpm")], din), din) == {}  # 1/min is that already
    assert with_units(din, {"n": "rpm"}).columns[2].unit == "rpm"
    with pytest.raises(DataError, match="gives 'M' the unit 'Nm'"):
        with_units(din, {"M": "rpm"})


def test_an_output_is_found_by_the_name_of_the_unknown_that_it_equals():
    signals = [Signal("substrate", "mol/m3"), Signal("product", "mol/m3"), Signal("level", "m")]
    columns = table("time", "S [mol/m3]", "P [mol/m3]", "L [K]")
    equal = {"substrate": "S", "product": "P", "level": "L"}
    how = "name of what it equals"
    found = [(match.column, match.how) for match in match_columns(signals, columns, None, equal)]
    assert found == [("S", how), ("P", how), (None, None)]


def test_most_words_of_a_description_decide_and_words_of_a_name_count():
    signals = [Signal("M1", "N.m"), Signal("M2", "N.m"), Signal("n1", "rpm"), Signal("n2", "rpm")]
    texts = ("torque of the motor", "torque of the brake", "speed of the motor", "speed of the brake")
    described = dict(zip(["M1", "M2", "n1", "n2"], texts, strict=True))
    headers = ("time", "Motor torque", "Brake torque", "Motor speed", "Brake speed")
    found = [match.column for match in match_columns(signals, table(*headers), described)]
    assert found == list(headers[1:])
    twice = table("time", "Motor torque", "Motor torque raw", "Motor speed")
    assert match_columns(signals[:1], twice, described)[0].column is None
    powers = [Signal("P_heater", "kW"), Signal("P_jets", "kW")]
    assert proposals(powers, "time", "heater_kW", "jets_kW", "heating_kW") == [
        ("heater_kW", "description"),
        ("jets_kW", "description"),
    ]


def test_a_description_that_names_a_channel_decides():
    signals = [Signal("r", "V"), Signal("y", "V")]
    described = {"r": "Set point, CH1", "y": "Tachometer (ch2)"}
    found = [match.column for match in match_columns(signals, table("time", "CH1", "CH2", "CH12"), described)]
    assert found == ["CH1", "CH2"]


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"Tiempo": ("s", [0, 1.7, 1.7, 3.4]), "energy": ("J", [0, 1, 2, 3])}, "Tiempo"),  # it stalls once
        ({"Tiempo": ("min", [0, 1, 2, 3]), "energy": ("J", [0, 1, 2, 3])}, "Tiempo"),
        ({"Tiempo": ("s", [0, 1, 2, 3]), "heated": ("s", [0, 0, 1, 1])}, "Tiempo"),
        ({"pulse": ("ms", [1, 1, 2, 2]), "pause": ("ms", [0, 3, 3, 4])}, None),  # two that may be it
        ({"pulse": ("ms", [5, 5, 5, 5]), "gap": ("s", [1, 0, 2, 3])}, None),
        ({"v": ("m/s", [0, 1, 1, 2]), "u": ("V", [0, 1, 1, 2])}, None),
    ],
)
def test_a_column_in_a_unit_of_time_that_never_falls_is_the_time(columns, expected):
    found = tuple(Column(name, unit, np.array(values, float)) for name, (unit, values) in columns.items())
    assert propose_time(Table("run.csv", found, None)) == expected
