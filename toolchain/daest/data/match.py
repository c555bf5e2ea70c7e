"""Which column is which model signal: proposals for a new daest.toml, never used in silence."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from daest.data.read import Signal
from daest.data.stamps import with_seconds
from daest.data.table import Column, Table, time_unit
from daest.errors import DataError
from daest.quantities import conversion, is_known_unit

_BEHIND = re.compile(r"_(?P<unit>[^_]+?)(?:_per_(?P<per>[^_]+))?$")
How = Literal["name", "similar name", "part of its name", "unit"]


@dataclass(frozen=True)
class Match:
    """A proposal: `column` (its name, None where nothing fits) for `signal`, and what spoke for it."""

    signal: Signal
    column: str | None
    how: How | None


_TIME_NAMES = ("t", "time", "zeit", "timestamp", "seconds", "sec", "elapsed")


def propose_time(table: Table) -> str | None:
    """A column for the time where none is called so: the one with a usual name, else the only one that
    increases throughout. None where there is a time, or nothing to choose."""
    if any(time_unit(column) is not None for column in table.columns):
        return None
    rising = [
        c for c in map(with_seconds, table.columns) if c.values.size > 1 and np.all(np.diff(c.values) > 0)
    ]
    named = [c for c in rising if re.split(r"[\s_(\[]", c.name.lower())[0] in _TIME_NAMES]
    chosen = named or rising
    return chosen[0].name if len(chosen) == 1 else None


def named_units(matches: Sequence[Match], table: Table) -> dict[str, str]:
    """Units that the names of matched columns end with (`motor_force_kN`), by column, where they convert."""
    found = {}
    for match in matches:
        column = table.find(match.column) if match.column is not None else None
        if column is not None and column.unit is None and _same_kind(column_unit(column), match.signal.unit):
            found[column.name] = column_unit(column)
    return found


def match_columns(signals: Sequence[Signal], table: Table) -> list[Match]:
    """One proposal per signal: the column of the same name, else of the same name but for case or a trailing
    unit (`position_m`), else the only free one whose name has the signal's in it (`goal_position` for `goal`)
    and whose unit fits, else the only free column of a fitting unit where no other signal has that unit."""
    free = [
        column for column in table.columns if column.name and time_unit(column) is None and not column.texts
    ]
    found: dict[str, Match] = {}
    for how in ("name", "similar name", "part of its name", "unit"):
        open_signals = [signal for signal in signals if signal.name not in found]
        for signal in open_signals:
            fits = [column for column in free if _fits(signal, column, how, open_signals)]
            if len(fits) == 1:
                found[signal.name] = Match(signal, fits[0].name, how)
                free.remove(fits[0])
    return [found.get(signal.name, Match(signal, None, None)) for signal in signals]


def _fits(signal: Signal, column: Column, how: How, others: Sequence[Signal]) -> bool:
    if how == "name":
        return signal.name in (column.name, column.header)
    if how == "similar name":
        names = {column.name.lower(), _stem(column.name).lower()}
        return signal.name.lower() in names or signal.name.rsplit(".", 1)[-1].lower() in names
    if how == "part of its name":
        unit = column_unit(column)
        bare = column.name if column.unit is not None or not unit else _BEHIND.sub("", column.name)
        is_part = _words(signal.name.rsplit(".", 1)[-1]) <= _words(bare)
        return is_part and (not unit or not signal.unit or _same_kind(unit, signal.unit))
    rivals = [other for other in others if other is not signal and _same_kind(other.unit, signal.unit)]
    return not rivals and bool(signal.unit) and _same_kind(column_unit(column), signal.unit)


def _words(name: str) -> set[str]:
    return {word for word in re.split(r"[\W_]+", name.lower()) if word}


def _stem(name: str) -> str:
    return name.rsplit("_", 1)[0] if "_" in name else name


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


def _same_kind(given: str, wanted: str) -> bool:
    if not given or not wanted:
        return False
    try:
        conversion(given, wanted)
    except DataError:
        return False
    return True
