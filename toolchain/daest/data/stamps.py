"""The column of the time in seconds: dates, and numbers in whatever unit they count."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

import numpy as np

from daest.data.table import Column, column_unit, time_unit
from daest.errors import DataError
from daest.model.quality import Finding, Level
from daest.quantities import conversion

_ANY_DAY = "2000-01-01T"  # of clock times without a date
# Seconds since 1970 of the years 2001 and 2100: numbers between them, or a thousand, a million or a milliard
# times as large, are dates, and tell their unit.
_EPOCH = (978_307_200.0, 4_102_444_800.0)
_EPOCH_UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


def told_unit(column: Column) -> str | None:
    """The unit in which the column of the time counts, where anything tells it: its header, the end of its
    name (`t_ms`), or values that are seconds, ms, us or ns since 1970. None: nothing tells it."""
    unit = column_unit(column)
    if column.unit is not None or (unit and _is_time(unit)):
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
    level: Level = "note" if time_unit(column) is not None else "warning"
    return [Finding("check-time-unit", level, column.name, text)]


def _is_time(unit: str) -> bool:
    try:
        conversion(unit, "s")
    except DataError:
        return False
    return True


def with_seconds(column: Column) -> Column:
    """The column with dates (`2026-11-21 08:15:00.25`) or clock times turned into seconds from the first row.

    A column that holds anything else, numbers too, is returned as it is. Dates without a zone are taken as
    they stand: a change to summer time in between shows as a jump of the clock.
    """
    if not column.texts or len(column.texts) != column.values.size:
        return column
    stamps = [_stamp(text) for _, text in column.texts]
    known = [stamp for stamp in stamps if stamp is not None]
    if len(known) != len(stamps) or len({stamp.tzinfo is None for stamp in known}) > 1:
        return column
    seconds = np.array([(stamp - known[0]).total_seconds() for stamp in known])
    return replace(column, values=seconds, texts=(), unit="s")


def _stamp(text: str) -> datetime | None:
    for form in (text, f"{_ANY_DAY}{text}"):
        try:
            return datetime.fromisoformat(form)
        except ValueError:
            continue
    return None
