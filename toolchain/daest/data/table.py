"""Table: the columns of a recording as they stand in its file, before they meet a model.

Several problems of one file are told in one message. The column of the time is read in seconds, from dates
and from numbers in whatever unit they count. Recordings that are in memory already (a pandas DataFrame, an
xarray Dataset or a mapping of arrays) become a table, too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daest.data.dates import seconds_of
from daest.errors import DaestError, DataError, Place
from daest.quantities import conversion, converts, dimensions, is_known_unit

if TYPE_CHECKING:
    from daest.model.experiment import Finding, Level

# `x[1]` is an array element, `x[1] [V]` and `T[degC]` carry a unit: a unit stands behind a space, or is no
# number. In round brackets (`speed (rad/s)`), behind a slash (`U/V`, `v / (m/s)`) or behind "in" (`t in s`),
# as DIN 461 and ISO 80000 write it, it is one only if it is a known unit; behind a space alone (`flow l/min`)
# only if it is one of a rate, which else would be a flow l in minutes.
_HEADER = re.compile(r"^(?P<name>.*?)(?:\s+\[(?P<unit>[^\]]*)\]|\[(?P<tight>[^\]\d][^\]]*)\])\s*$")
_ROUND = re.compile(r"^(?P<name>[^()]*[^()\s/])\s*/?\s*\((?P<unit>[^()]+)\)$")
_BEHIND_SLASH = re.compile(r"^(?P<name>[^/]*[^/\s])\s*/\s*(?P<unit>.+)$")
_BEHIND_IN = re.compile(r"^(?P<name>.*\S)\s+in\s+(?P<unit>\S+)$")
_BEHIND_SPACE = re.compile(r"^(?P<name>.*[^\s/])\s+(?P<unit>(?!t/)[^\s/]+/(?P<per>[^\s/]+))$")  # `Zeit t/s`
_LETTERS = "VAsmNKJWCFTHghdlL%°Ω"  # units of one letter that a header gives behind a slash
_TIME = re.compile(r"^time(?:_(?P<unit>s|ms|us|min|h))?$", re.IGNORECASE)
_BEHIND = re.compile(r"_(?P<unit>[^_]+?)(?:_per_(?P<per>[^_]+))?$")
_BEHIND_RATE = re.compile(r"_(?P<unit>[^_]+)_(?P<per>s2?|h)$")  # not min, which may be a minimum


@dataclass(frozen=True)
class Column:
    """One column: `values` (n_rows,), NaN where a cell is empty or no number; `texts` lists (row, cell text)
    of the cells that are no number. `unit` is None where the header names none; `position` counts from 1."""

    name: str
    unit: str | None
    values: np.ndarray
    texts: tuple[tuple[int, str], ...] = ()
    position: int = 0

    @property
    def header(self) -> str:
        return self.name if self.unit is None else f"{self.name} [{self.unit}]"


@dataclass(frozen=True)
class Part:
    """What of a recording is wanted: the columns `names`, with or without their units (None: all), at times
    from `start` to `stop` in seconds (None: open). `time` is the column of the time (None: see `find_time`),
    `units` are those of columns whose header has none. A reader may give more."""

    names: tuple[str, ...] | None = None
    start: float | None = None
    stop: float | None = None
    time: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Table:
    """The columns of a file; `lines` (n_rows,) are line numbers for messages, None where a file has no
    lines, and `header_line` is that of the names. `notes` say how the file was read where that was not
    plain; `left_out` says of what is no column, by name, why; `unread` names columns that were not wanted."""

    file: str
    columns: tuple[Column, ...]
    lines: np.ndarray | range | None
    header_line: int = 1
    notes: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    unread: tuple[str, ...] = ()

    def place(self, row: int | None = None, column: Column | None = None) -> Place:
        """Where a row (counted from 0) stands; the header without one."""
        position = column.position if column is not None and column.position else None
        if self.lines is None:
            return Place(self.file)
        line = self.header_line if row is None else int(self.lines[row])
        return Place(self.file, line, position)

    def find(self, name: str) -> Column | None:
        """The column called `name`, with or without its unit, which may stand as in the file (`U/V`)."""
        for column in self.columns:
            if name in (column.name, column.header):
                return column
        parts = split_header(name)
        return next((c for c in self.columns if (c.name, c.unit) == parts), None)

    @property
    def names(self) -> tuple[str, ...]:
        return (*(column.name for column in self.columns if column.name), *self.unread)


def split_header(text: str) -> tuple[str, str | None]:
    """Name and unit of a header cell, `speed [rad/s]` -> (`speed`, `rad/s`); the unit is None if there is
    none. `speed (rad/s)`, `speed/(rad/s)`, `speed / rad/s`, `speed in rad/s`, `speed rad/s` are the same."""
    text = text.strip()
    match = _HEADER.match(text)
    if match is not None:
        unit = match["unit"] if match["unit"] is not None else match["tight"]
        return match["name"].strip(), unit.strip()
    for form in (_ROUND, _BEHIND_IN, _BEHIND_SPACE, _BEHIND_SLASH):
        match = form.match(text)
        if match is None or not is_known_unit(match["unit"].strip()):
            continue
        name, unit = match["name"], match["unit"].strip()
        if form is _BEHIND_SPACE and not _is_time_alone(match["per"]):
            continue
        if form is not _BEHIND_SLASH or not _is_no_quantity(name, unit):
            return name, unit
    return text, None


def _is_no_quantity(name: str, unit: str) -> bool:
    """Whether `name/unit` is the unit of a rate (`m/s`, `U/min`) or a ratio of two things (`a/b`, where b
    happens to be a rare unit, too) rather than a quantity in its unit. Times alone are written as `t/s`."""
    if len(unit) == 1 and unit not in _LETTERS:
        return True
    return is_known_unit(name) and dimensions(unit) == {"[time]": 1.0} and name.lower() != "t"


def _is_time_alone(unit: str) -> bool:
    """Whether a unit is one of time, or a power of it."""
    return is_known_unit(unit) and set(dimensions(unit) or ()) == {"[time]"}


def column_unit(column: Column) -> str:
    """The unit in the header, else the known one that the name ends with (`motor_force_N`, `speed_rad_per_s`,
    `speed_rad_s`), else the empty text."""
    return column.unit if column.unit is not None else _name_and_unit(column.name)[1]


def stem(column: Column) -> str:
    """The name of the column without the unit that it ends with."""
    return column.name if column.unit is not None else _name_and_unit(column.name)[0]


def _name_and_unit(name: str) -> tuple[str, str]:
    """A name without the known unit that it ends with, and that unit; the whole name and the empty text where
    it ends with none."""
    rate = _BEHIND_RATE.search(name)
    if rate is not None and is_known_unit(rate["unit"]) and not converts(rate["unit"], "s"):
        return name[: rate.start()], f"{rate['unit']}/{rate['per']}"
    behind = _BEHIND.search(name)
    if behind is None:
        return name, ""
    unit = f"{behind['unit']}/{behind['per']}" if behind["per"] else behind["unit"]
    return (name[: behind.start()], unit) if is_known_unit(unit) else (name, "")


def is_time(name: str) -> bool:
    """Whether a column of this name is the time."""
    return _TIME.match(name) is not None


def time_unit(column: Column) -> str | None:
    """Unit of a column that is the time by its name (`time`, `time_s`, `time_ms`, `time [ms]`), else None."""
    match = _TIME.match(column.name)
    if match is None:
        return None
    return column.unit or (match["unit"] or "s").lower()


def time_column(table: Table, name: str | None = None) -> Column | None:
    """The column called `name`, else the only one that is the time by its name; None where there is none."""
    if name is not None:
        return table.find(name)
    times = [column for column in table.columns if time_unit(column) is not None]
    return times[0] if len(times) == 1 else None


def counted_column(table: Table, clock: str, name: str | None = None) -> Column | None:
    """The `time_column` where it tells its unit or holds dates, so that it is read in `clock`, the unit in
    which a model counts; None where that is seconds, or nothing tells what the column counts."""
    column = time_column(table, name) if clock != "s" else None
    if column is None or (told_unit(column) is None and not column.texts):
        return None
    return column


def duplicate_columns(table: Table) -> list[DataError]:
    """One problem for every name that two columns of the table share."""
    seen: dict[str, Column] = {}
    problems = []
    for column in table.columns:
        if column.name and column.name in seen:
            problems.append(
                DataError(
                    "data-duplicate-column",
                    f"column '{column.name}' stands twice (columns {seen[column.name].position} and "
                    f"{column.position})",
                    where=table.place(None, column),
                    remedy="rename or remove one of them",
                )
            )
        seen.setdefault(column.name, column)
    return problems


MOST_SHOWN = 12


def raise_collected(problems: Sequence[DaestError], source: str) -> None:
    """Return if there is no problem; raise the only one; or raise one error of the same class that lists all
    of them.

    The class and, if all agree, the code are those of the first problem, else the code is `several-problems`.
    """
    if not problems:
        return
    if len(problems) == 1:
        raise problems[0]
    first = problems[0]
    same = all(problem.code == first.code for problem in problems)
    lines = [f"{len(problems)} problems in {source}"]
    lines += [_indented(problem) for problem in problems[:MOST_SHOWN]]
    if len(problems) > MOST_SHOWN:
        lines.append(f"  ... and {len(problems) - MOST_SHOWN} more")
    code = first.code if same else "several-problems"
    raise type(first)(code, "\n".join(lines), problems=problems)


def empty_file(path: Path, what: str) -> DataError:
    """DataError `data-empty-file` of a file of rows; `what` says that it is empty."""
    return DataError(
        "data-empty-file",
        what,
        where=Place(str(path)),
        remedy="a recording needs a header row and at least two rows of numbers",
    )


def unreadable_file(path: Path, what: str, remedy: str) -> DataError:
    """DataError `data-unreadable-file`."""
    return DataError("data-unreadable-file", what, where=Place(str(path)), remedy=remedy)


def _indented(problem: DaestError) -> str:
    return "\n".join("  " + line for line in str(problem).splitlines())


# Seconds since 1970 of the years 2001 and 2100: numbers between them, or a thousand, a million or a milliard
# times as large, are dates, and tell their unit.
_EPOCH = (978_307_200.0, 4_102_444_800.0)
_EPOCH_UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


def told_unit(column: Column) -> str | None:
    """The unit in which the column of the time counts, where anything tells it: its header, the end of its
    name (`t_ms`), or values that are seconds, ms, us or ns since 1970. None: nothing tells it."""
    unit = column_unit(column)
    if column.unit is not None or (unit and converts(unit, "s")):
        return unit
    return _epoch_unit(column.values)


def cut_unit(column: Column) -> str | None:
    """The unit of a column of the time that counts from zero, whose first rows `column` holds: known without
    the others. None where seconds count from the first row."""
    is_counted = not column.texts and _epoch_unit(column.values) is None
    return (told_unit(column) or time_unit(column) or "s") if is_counted else None


def in_seconds(column: Column) -> np.ndarray:
    """Values (n_rows,) of the column of the time in s; seconds where nothing tells their unit.

    Numbers that count from 1970 are turned into seconds from the first row, as dates are: a double holds
    them to a fraction of a microsecond only.
    """
    values = column.values
    start = np.nanmin(values) if _epoch_unit(values) is not None else 0.0
    return conversion(told_unit(column) or time_unit(column) or "s", "s")(values - start)


def _epoch_unit(values: np.ndarray) -> str | None:
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    (low, high), scales = _EPOCH, _EPOCH_UNITS.items()
    return next((u for u, k in scales if low * k <= known.min() and known.max() <= high * k), None)


def unit_findings(column: Column) -> list[Finding]:
    """A finding where nothing tells the unit of the time and its values are whole numbers, which may as well
    count milliseconds or samples. Times called `time` are seconds by agreement, so this is only noted."""
    steps = np.diff(column.values[np.isfinite(column.values)])
    if told_unit(column) is not None or not steps.size or not np.all(steps == np.round(steps)):
        return []
    step = float(np.median(steps))
    text = (
        f"has no unit and is read as seconds: a step is {step:g} s; if it counts something else, call it "
        f"'{column.name} [ms]' or write [data.units] {column.name} = \"ms\" in daest.toml"
    )
    from daest.model.experiment import Finding

    level: Level = "note" if time_unit(column) is not None else "warning"
    return [Finding("check-time-unit", level, column.name, text)]


def with_seconds(column: Column) -> Column:
    """The column with dates or clock times (`dates.seconds_of`) turned into seconds from the first row.

    A column that holds anything else, numbers too, is returned as it is. Dates without a zone are taken as
    they stand: a change to summer time in between shows as a jump of the clock.
    """
    if not column.texts or len(column.texts) != column.values.size:
        return column
    seconds = seconds_of([text for _, text in column.texts])
    return column if seconds is None else replace(column, values=np.array(seconds), texts=(), unit="s")


DATES = "mM"  # numpy kinds of dates and durations


def is_frame(data: object) -> bool:
    """Whether `data` is a DataFrame, a Dataset or a dictionary, told without importing pandas or xarray."""
    if isinstance(data, dict):
        return True
    package = type(data).__module__.partition(".")[0]
    return (package, type(data).__name__) in {("pandas", "DataFrame"), ("xarray", "Dataset")}


def frame_table(data: Any, name: str) -> Table:
    """The table of a DataFrame, of a Dataset whose variables have one dimension in common, or of a mapping of
    arrays {"time": t, "u [V]": u}.

    An index (a coordinate) that is called time, or holds dates, is the column `time`; dates become seconds
    from the first row. Units stand in the column names as in a file, `omega [rad/s]`, or in the attribute
    `units` of a variable of a Dataset. Raises DataError `data-frame` for a Dataset of several dimensions, and
    for arrays of several lengths.
    """
    if isinstance(data, dict):
        return _of_arrays(data, name)
    if type(data).__name__ == "Dataset":
        return _of_dataset(data, name)
    columns = [_column(str(header), data[header], None) for header in data.columns]
    return Table(name, (*_index(data.index, columns), *columns), None)


def _of_arrays(data: Mapping[Any, Any], name: str) -> Table:
    arrays = {str(header): np.atleast_1d(np.asarray(values)) for header, values in data.items()}
    sizes = {header: "x".join(map(str, values.shape)) for header, values in arrays.items()}
    if len(set(sizes.values())) != 1 or any(values.ndim != 1 for values in arrays.values()):
        told = ", ".join(f"{header} {size}" for header, size in sizes.items()) or "none"
        raise DataError(
            "data-frame",
            f"the arrays have the sizes: {told}",
            where=name,
            remedy="give one-dimensional arrays of one length, with the time among them",
        )
    return Table(name, tuple(_column(header, values, None) for header, values in arrays.items()), None)


def _of_dataset(data: Any, name: str) -> Table:
    if len(data.dims) != 1:
        raise DataError(
            "data-frame",
            f"the Dataset has the dimensions {', '.join(map(str, data.dims)) or 'none'}",
            where=name,
            remedy="select variables with the dimension time alone",
        )
    series = {str(key): value for key, value in data.variables.items() if value.ndim == 1}
    columns = [_column(key, value.to_numpy(), value.attrs.get("units")) for key, value in series.items()]
    (dimension,) = map(str, data.dims)
    columns = [_as_time(c, np.asarray(series[c.name])) if c.name == dimension else c for c in columns]
    return Table(name, tuple(columns), None)


def _index(index: Any, columns: list[Column]) -> list[Column]:
    """The index as a column, if it is one: named, or of dates."""
    if index.name is None and index.dtype.kind not in DATES:
        return []
    column = _column(str(index.name or "time"), index.to_series(), None)
    if any(c.name == column.name for c in columns):
        return []
    return [_as_time(column, np.asarray(index))]


def _as_time(column: Column, values: np.ndarray) -> Column:
    """Dates are the time, whatever the name."""
    return Column("time", "s", column.values) if values.dtype.kind in DATES else column


def _column(header: str, series: Any, unit: str | None) -> Column:
    name, in_header = split_header(header)
    unit = in_header if unit is None else str(unit)
    raw = np.asarray(series)
    if raw.dtype.kind in DATES:
        start = raw[0] if raw.dtype.kind == "M" and raw.size else np.timedelta64(0, "ns")
        seconds = (raw - start) / np.timedelta64(1, "s")
        return Column(name, "s", seconds.astype(float))
    if raw.dtype.kind in "fiub":
        return Column(name, unit, raw.astype(float))
    return _mixed(name, unit, series)


def _mixed(name: str, unit: str | None, series: Any) -> Column:
    """A column of texts and numbers, or with pandas' own missing values."""
    import pandas as pd

    series = pd.Series(series)
    values = np.asarray(pd.to_numeric(series, errors="coerce"), dtype=float)
    given = np.asarray(pd.notna(series))
    rows = np.nonzero(given & np.isnan(values))[0]
    return Column(name, unit, values, tuple((int(row), str(series.iloc[row])) for row in rows))
