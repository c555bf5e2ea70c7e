"""Table: the columns of a recording as they stand in its file, before they meet a model."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from daest.errors import DataError, Place
from daest.quantities import is_known_unit

# `x[1]` is an array element, `x[1] [V]` and `T[degC]` carry a unit: a unit stands behind a space, or is no
# number. In round brackets (`speed (rad/s)`) it is one only if it is a known unit.
_HEADER = re.compile(r"^(?P<name>.*?)(?:\s+\[(?P<unit>[^\]]*)\]|\[(?P<tight>[^\]\d][^\]]*)\])\s*$")
_ROUND = re.compile(r"^(?P<name>[^()]*[^()\s])\s*\((?P<unit>[^()]+)\)$")
_TIME = re.compile(r"^time(?:_(?P<unit>s|ms|us|min|h))?$", re.IGNORECASE)
_BEHIND = re.compile(r"_(?P<unit>[^_]+?)(?:_per_(?P<per>[^_]+))?$")


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
        """The column called `name`, with or without its unit."""
        for column in self.columns:
            if name in (column.name, column.header):
                return column
        return None

    @property
    def names(self) -> tuple[str, ...]:
        return (*(column.name for column in self.columns if column.name), *self.unread)


def split_header(text: str) -> tuple[str, str | None]:
    """Name and unit of a header cell, `speed [rad/s]` -> (`speed`, `rad/s`); the unit is None if there is
    none."""
    match = _HEADER.match(text.strip())
    if match is None:
        return _split_round(text.strip())
    unit = match["unit"] if match["unit"] is not None else match["tight"]
    return match["name"].strip(), unit.strip()


def _split_round(text: str) -> tuple[str, str | None]:
    match = _ROUND.match(text)
    if match is None or not is_known_unit(match["unit"]):
        return text, None
    return match["name"], match["unit"].strip()


def column_unit(column: Column) -> str:
    """The unit in the header, else the known one behind the last underscore of the name (`motor_force_N`,
    `speed_rad_per_s`), else the empty text."""
    if column.unit is not None:
        return column.unit
    behind = _BEHIND.search(column.name)
    if behind is None:
        return ""
    unit = f"{behind['unit']}/{behind['per']}" if behind["per"] else behind["unit"]
    return unit if is_known_unit(unit) else ""


def stem(column: Column) -> str:
    """The name of the column without the unit that it ends with."""
    return column.name if column.unit is not None or not column_unit(column) else _BEHIND.sub("", column.name)


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


def nearest(name: str, candidates: Iterable[str]) -> str:
    """`did you mean ...?` for a name that does not exist, or the empty text."""
    pool = list(candidates)
    lower = {candidate.lower(): candidate for candidate in reversed(pool)}
    close = difflib.get_close_matches(name.lower(), list(lower), n=3, cutoff=0.6)
    return f"did you mean {', '.join(lower[c] for c in close)}?" if close else ""


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
