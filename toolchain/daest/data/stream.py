"""Lines of a stream, CSV or JSON, as samples in the names and the units of a model.

The first line tells the format: `{` begins a JSON object per line, anything else is the header row of a CSV.
Only one line is in memory at a time.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daest.data.grid import cell_number
from daest.data.read import Signal, find_time, match_all, reading, with_units
from daest.data.table import (
    Column,
    Table,
    duplicate_columns,
    raise_collected,
    split_header,
    time_unit,
    told_unit,
)
from daest.errors import DataError, Place
from daest.model.estimates import Sample
from daest.quantities import Conversion

SEPARATORS = (",", ";", "\t", "|")
MOST_CHARACTERS = 1 << 20  # of one line


@dataclass(frozen=True)
class _Cell:
    """Where a signal stands in a line: position of a CSV cell, or key of a JSON object; `change` None: the
    value is in the unit of the model."""

    key: Any
    name: str
    change: Conversion | None = None


@dataclass(frozen=True)
class LineFormat:
    """How a line becomes a sample. `separator` None: JSON objects. `inputs` and `outputs` in the order of the
    model; `n_cells`: of a CSV line."""

    source: str
    separator: str | None
    time: _Cell
    inputs: tuple[_Cell, ...]
    outputs: tuple[_Cell, ...]
    n_cells: int = 0

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(cell.name for cell in self.outputs)

    def with_outputs(self, names: Sequence[str]) -> LineFormat:
        """The format that reads these outputs alone, in this order."""
        cells = {cell.name: cell for cell in self.outputs}
        return replace(self, outputs=tuple(cells[name] for name in names))

    def sample(self, line: str, number: int) -> Sample:
        """The sample of a line. Raises DataError `stream-line` with the line's number."""
        row = self._row(line, number)
        time = self._value(row, self.time, number)
        if not math.isfinite(time):
            raise _bad_line(self.source, number, "the time is missing")
        inputs = np.array([self._value(row, cell, number) for cell in self.inputs])
        if not np.all(np.isfinite(inputs)):
            name = self.inputs[int(np.flatnonzero(~np.isfinite(inputs))[0])].name
            raise _bad_line(self.source, number, f"input {name} has no value")
        return Sample(time, inputs, np.array([self._value(row, cell, number) for cell in self.outputs]))

    def _row(self, line: str, number: int) -> Any:
        if len(line) > MOST_CHARACTERS:
            raise _bad_line(self.source, number, f"more than {MOST_CHARACTERS} characters")
        if self.separator is None:
            return _object(line, self.source, number)
        cells = _cells(line, self.separator, self.source, number)
        if len(cells) != self.n_cells:
            raise _bad_line(self.source, number, f"{len(cells)} cells, and the header has {self.n_cells}")
        return cells

    def _value(self, row: Any, cell: _Cell, number: int) -> float:
        value = _number(row.get(cell.key)) if self.separator is None else _read(row[cell.key], self.separator)
        if value is None:
            found = row.get(cell.key) if self.separator is None else row[cell.key]
            raise _bad_line(self.source, number, f"{cell.name} is {str(found)[:40]!r}, not a number")
        if math.isinf(value):
            raise _bad_line(self.source, number, f"{cell.name} is infinite")
        return value if cell.change is None else float(cell.change(np.array([value]))[0])


def line_format(
    line: str,
    source: str,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    time: str | None = None,
    units: Mapping[str, str] | None = None,
    number: int = 1,
    clock: str = "s",
) -> LineFormat:
    """The format that the first line of a stream tells: a CSV header, or the keys of a JSON object.

    `time`, `units` and `clock` as in `read_experiments`. Only the outputs that the line names are read.
    Raises DataError with all problems at once: no time, missing inputs, units that do not fit, no output.
    """
    is_json = line.lstrip().startswith("{")
    separator = None if is_json else max(SEPARATORS, key=line.count)
    names = (
        list(_object(line, source, number)) if separator is None else _cells(line, separator, source, number)
    )
    columns = tuple(
        Column(*split_header(name), np.empty(0), position=0 if is_json else i)
        for i, name in enumerate(names, 1)
    )
    keys = dict(zip(map(id, columns), names if is_json else range(len(names)), strict=True))
    bare = Table(source, columns, None, number)
    table = with_units(bare, units or {})
    keys = {id(new): keys[id(old)] for new, old in zip(table.columns, columns, strict=True)}
    raise_collected(duplicate_columns(table), source)
    at = find_time(table, time)
    matched: dict[str, Column] = {}
    problems: list[DataError] = []
    match_all(table, inputs, outputs, matched, problems)
    raise_collected(problems, source)

    def cells(signals: Sequence[Signal]) -> tuple[_Cell, ...]:
        return tuple(_cell(matched[s.name], s, keys) for s in signals if s.name in matched)

    unit = time_unit(at) or told_unit(at) or "s"
    own = clock if told_unit(at) is not None else "s"
    counted = _cell(at, Signal("the time", own), keys, unit)
    return LineFormat(source, separator, counted, cells(inputs), cells(outputs), len(names))


def _cell(column: Column, signal: Signal, keys: Mapping[int, Any], unit: str | None = None) -> _Cell:
    change = reading(signal, unit or column.unit)
    return _Cell(keys[id(column)], signal.name, None if change.is_identity else change)


def _cells(line: str, separator: str, source: str, number: int) -> list[str]:
    try:
        rows = list(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True))
    except csv.Error as error:
        raise _bad_line(source, number, f"not a line of CSV: {error}") from error
    return [cell.strip() for cell in rows[0]] if rows else []


def _object(line: str, source: str, number: int) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise _bad_line(source, number, f"not a JSON object: {error}") from error
    if not isinstance(found, dict):
        raise _bad_line(source, number, "not a JSON object")
    return found


def _read(cell: str, separator: str) -> float | None:
    """A decimal comma is read where commas do not part cells."""
    has_comma = separator != "," and "," in cell
    return cell_number(cell, "," if has_comma else ".")


def _number(value: Any) -> float | None:
    if value is None:
        return math.nan
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _bad_line(source: str, number: int, what: str) -> DataError:
    return DataError(
        "stream-line",
        f"this line is no sample: {what}",
        where=Place(source, number),
        remedy="every line needs the time, all inputs as numbers, and an empty cell (null) for a missing "
        "output",
    )
