"""Large CSV files: the way by Arrow gives what the way cell by cell gives, and leaves faults to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daest.data import csv_file
from daest.data.csv_file import read_csv
from daest.data.prepare import Preparation
from daest.data.read import Signal, read_experiments
from daest.data.table import Part
from daest.errors import DataError

ROWS = 3000


@pytest.fixture
def by_arrow(monkeypatch):
    """Every file is large, and its look is told from few lines; the calls of the way by Arrow."""
    calls = []

    def counted(*arguments):
        table = real(*arguments)
        calls.append(table is not None)
        return table

    real = csv_file.read_numbers
    monkeypatch.setattr(csv_file, "read_numbers", counted)
    monkeypatch.setattr(csv_file, "LARGE", 0)
    monkeypatch.setattr(csv_file, "HEAD", 2000)
    return calls


def lines(separator=",", decimal=".", header="time,u [V],omega"):
    rng = np.random.default_rng(4)
    values = rng.standard_normal((ROWS, 2)) * 10.0 ** rng.integers(-12, 12, (ROWS, 2))
    rows = [f"{k / 100!r},{a!r},{b!r}" for k, (a, b) in enumerate(values.tolist())]
    return [t.replace(",", ";").replace(".", decimal).replace(";", separator) for t in (header, *rows)]


def written(folder: Path, rows: list[str], ending="\n") -> Path:
    path = folder / "run.csv"
    path.write_bytes((ending.join(rows) + ending).encode())
    return path


def slowly(path: Path):
    return csv_file._table(*csv_file._decoded(path.read_bytes(), path), path)[0]


def same(one, other):
    assert one.notes == other.notes and one.header_line == other.header_line
    assert list(one.lines) == list(other.lines)
    for a, b in zip(one.columns, other.columns, strict=True):
        assert (a.name, a.unit, a.position, a.texts) == (b.name, b.unit, b.position, b.texts)
        assert np.array_equal(a.values, b.values, equal_nan=True)


@pytest.mark.parametrize(
    ("rows", "ending"),
    [
        (lines(), "\n"),
        (lines(), "\r\n"),
        (lines(";"), "\n"),
        (lines("\t", ","), "\n"),
        (["# a logger", "", *lines()[:1], "s,V,rad/s", *lines()[1:]], "\n"),
        ([*lines()[:2000], "19.99,,nan", "20.0,NA,--", *lines()[2002:], "", " "], "\n"),
    ],
    ids=["comma", "windows", "semicolon", "decimal comma", "units below", "missing"],
)
def test_equal_to_cell_by_cell(tmp_path, by_arrow, rows, ending):
    path = written(tmp_path, rows, ending)
    same(read_csv(path), slowly(path))
    assert by_arrow == [True]


@pytest.mark.parametrize(
    "row",
    ["25.0,broken,1.0", "25.0,1.0", "25.0,1_0,1.0", "# pause", ",,", '25.0,"1.0",1.0', "25.0,+1.0,0x1"],
)
def test_what_is_no_row_of_numbers_is_left_to_cell_by_cell(tmp_path, by_arrow, row):
    path = written(tmp_path, [*lines()[:2501], row, *lines()[2502:]])
    try:
        expected = slowly(path)
    except DataError as error:
        with pytest.raises(DataError) as found:
            read_csv(path)
        assert str(found.value) == str(error) and ":2502" in str(error)
    else:
        same(read_csv(path), expected)
    assert by_arrow == [False]


def read(path, **window):
    signals = [Signal("u", "V")], [Signal("omega"), Signal("not recorded")]
    return read_experiments([path], *signals, Preparation(**window), others=False)[0]


def test_window_is_the_one_of_the_whole_table(tmp_path, by_arrow, monkeypatch):
    path = written(tmp_path, lines())
    part = read(path, start=3.0, stop=4.0)
    monkeypatch.setattr(csv_file, "LARGE", 1 << 30)
    whole = read(path, start=3.0, stop=4.0)
    assert part.time.size == 101
    for name in ("time", "inputs", "outputs"):
        assert np.array_equal(getattr(part, name), getattr(whole, name), equal_nan=True)


def test_only_wanted_columns_are_held(tmp_path, by_arrow):
    table = read_csv(written(tmp_path, lines()), Part(("omega",), None, 1.0))
    assert [column.name for column in table.columns] == ["time", "omega"]
    assert table.names == ("time", "omega", "u") and table.columns[1].position == 3


@pytest.mark.parametrize(
    ("row", "window", "code", "line"),
    [
        ("25.0,broken,1.0", {"stop": 40.0}, "data-text", 2502),
        ("24.0,1.0,1.0", {"start": 20.0}, "data-time-not-increasing", 2502),
        ("25.0,,1.0", {"start": 20.0}, "data-input-gap", 2502),
    ],
)
def test_faults_in_a_window_have_their_lines(tmp_path, by_arrow, row, window, code, line):
    path = written(tmp_path, [*lines()[:2501], row, *lines()[2502:]])
    with pytest.raises(DataError) as found:
        read(path, **window)
    problem = (found.value.problems or (found.value,))[0]
    assert problem.code == code and problem.where.line == line


def test_window_outside_tells_the_whole_recording(tmp_path, by_arrow):
    with pytest.raises(DataError, match=r"reaches from 0 s to 29.99 s"):
        read(written(tmp_path, lines()), start=100.0)
    assert by_arrow == [True]


@pytest.mark.parametrize(
    ("header", "scale", "start", "units"),
    [
        ("time [ms],u [V],omega", 1e3, 0, {}),
        ("time,u [V],omega", 1e3, 0, {"time": "ms"}),
        ("time,u [V],omega", 1e3, 1.7e12, {}),
    ],
    ids=["header", "project", "since 1970"],
)
def test_window_in_other_units(tmp_path, by_arrow, header, scale, start, units):
    rows = [row.split(",") for row in lines()[1:]]
    path = written(tmp_path, [header, *(f"{start + scale * float(t):.0f},{a},{b}" for t, a, b in rows)])
    signals, window = ([Signal("u", "V")], [Signal("omega")]), Preparation(start=3.0, stop=4.0)
    (part,) = read_experiments([path], *signals, window, units=units, others=False)
    assert part.time == pytest.approx(3.0 + np.arange(101) / 100, abs=1e-9)
    assert part.outputs[0, 0] == float(rows[300][2]) and by_arrow[0]
