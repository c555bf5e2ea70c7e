"""Which column is which model signal: proposals for a new daest.toml, never used in silence."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from daest.data.read import Signal
from daest.data.table import (
    Column,
    Table,
    column_unit,
    counted_column,
    stem,
    time_unit,
    told_unit,
    with_seconds,
)
from daest.model.experiment import Finding
from daest.quantities import converts, is_known_unit, is_temperature, may_count_turns

How = Literal[
    "name",
    "similar name",
    "name of what it equals",
    "part of its name",
    "description",
    "unit",
    "being the only one left",
]

HOWS: tuple[How, ...] = get_args(How)[:-1]  # in their order; the last is asked of all signals together
TELLING_LETTERS = (
    4  # a shorter word of a description (`of`, `the`) tells nothing; judgement, no study varied it
)


@dataclass(frozen=True)
class Match:
    """A proposal: `column` (its name, None where nothing fits) for `signal`, and what spoke for it."""

    signal: Signal
    column: str | None
    how: How | None


_IS_TEMPERATURE = re.compile(r"(?i:temp)|^T(?![a-z])|^T[a-z]{1,3}(?![a-zA-Z])")  # T_out, Tamb, T2, temp_in
_TIME_NAMES = ("t", "time", "zeit", "timestamp", "seconds", "sec", "elapsed")


def propose_time(table: Table) -> str | None:
    """A column for the time where none is called so: the one with a usual name, else the one of dates, else
    the only one whose header has a unit of time and that never falls, else the only one that increases
    throughout. None where there is a time, or nothing to choose."""
    return _proposed(table, by_values=True)


def told_time(table: Table) -> str | None:
    """As `propose_time`, but for a column that nothing but its values tell: what fills increases, too."""
    return _proposed(table, by_values=False)


def _proposed(table: Table, by_values: bool) -> str | None:
    if any(time_unit(column) is not None for column in table.columns):
        return None
    rising = [
        c for c in map(with_seconds, table.columns) if c.values.size > 1 and np.all(np.diff(c.values) > 0)
    ]
    of_text = {column.name for column in table.columns if column.texts}
    dated = [c for c in rising if c.name in of_text]
    # Beside dates a T that rises is a temperature.
    named = [c for c in rising if is_called_time(c.name) and not (dated and c.name == "T")]
    counting = [c for c in table.columns if counts_time(c)]
    last = rising if by_values else []
    chosen = named or dated or [c for c in rising if counts_time(c)] or counting or last
    return chosen[0].name if len(chosen) == 1 else None


def counts_time(column: Column) -> bool:
    """Whether the header of a column has a unit of time, as `Tiempo (s)`, and its values never fall. They may
    stand still: a logger that stalls writes rows of one time, of which the check of clocks tells."""
    if not column.unit or not _same_kind(column.unit, "s") or column.values.size < 2:
        return False
    return bool(np.all(np.diff(column.values) >= 0) and column.values[-1] > column.values[0])


def is_called_time(name: str) -> bool:
    """Whether a column has one of the usual names of the time (`t`, `t [s]`, `elapsed_ms`)."""
    return re.split(r"[\s_(\[]", name.lower())[0] in _TIME_NAMES


def named_units(matches: Sequence[Match], table: Table) -> dict[str, str]:
    """Units that the names of matched columns end with (`motor_force_kN`), by column, where they convert; rpm
    for what a rig writes in 1/min where the model has an angular speed."""
    found = {}
    for match in matches:
        column = table.find(match.column) if match.column is not None else None
        if column is None:
            continue
        unit = _told_unit(column, match.signal)
        if unit != column.unit and _same_kind(unit, match.signal.unit):
            found[column.name] = unit
    return found


def _told_unit(column: Column, signal: Signal) -> str:
    """The unit of a column that may be the signal: rpm for 1/min where the signal is an angular speed in
    rad/s or deg/s, since nobody counts radians in a minute."""
    unit = column_unit(column)
    is_speed = may_count_turns(unit, "rpm") and _same_kind("rpm", signal.unit)
    is_speed = is_speed and not _same_kind(unit, signal.unit)
    return "rpm" if is_speed else unit


def other_temperatures(matches: Sequence[Match], table: Table) -> dict[str, str]:
    """The unit of columns without one that no signal has, are called like a temperature, and stand beside
    temperatures of the model that are all in one unit: a law may need them."""
    matched = [m for m in matches if m.column is not None and is_temperature(m.signal.unit)]
    taken = {m.column for m in matches}
    units = {_unit_in(table, m) for m in matched}
    if len(units) != 1:
        return {}
    (unit,) = units
    return {
        c.name: unit
        for c in table.columns
        if c.unit is None and c.name not in taken and not c.texts and _IS_TEMPERATURE.search(c.name)
    }


def _unit_in(table: Table, match: Match) -> str:
    """That of a matched column: its own, or the one of the model, as which it is read."""
    column = table.find(match.column or "")
    return (column.unit if column is not None else None) or match.signal.unit


def named_time_unit(table: Table) -> dict[str, str]:
    """The unit of the proposed column of the time, by its name, where something else than the header tells
    it."""
    name = propose_time(table)
    column = table.find(name) if name is not None else None
    if column is None or column.unit is not None or len(column.texts):
        return {}
    unit = told_unit(column)
    return {column.name: unit} if unit is not None else {}


def match_columns(
    signals: Sequence[Signal],
    table: Table,
    described: Mapping[str, str] | None = None,
    equal: Mapping[str, str] | None = None,
) -> list[Match]:
    """One proposal per signal: the column of the same name, else of the same name but for case or a trailing
    unit (`position_m`), else such a one of the unknown that it equals, else the only free one whose name has
    the signal's in it (`goal_position` for `goal`) and whose unit fits, else the one whose name has most
    words of what the model says of the signal, its name included (`T_office` for "Office", `heater_kW` for
    `P_heater`), else the only free column of a fitting unit where no other signal has that unit. Where one
    signal and one column are left in the end, they belong together unless their units differ in kind.
    `described` holds the descriptions by signal, `equal` the names of the unknowns that signals equal."""
    proposed = propose_time(table)
    free = [
        column
        for column in table.columns
        if column.name and time_unit(column) is None and column.name != proposed and not column.texts
    ]
    found: dict[str, Match] = {}
    for how in HOWS:
        open_signals = [signal for signal in signals if signal.name not in found]
        if how == "description":
            pairs = _described_pairs(open_signals, free, described or {})
            found |= {signal.name: Match(signal, column.name, how) for signal, column in pairs}
            free = [column for column in free if all(column is not taken for _, taken in pairs)]
            continue
        for signal in open_signals:
            meant = signal
            if how == "name of what it equals":
                if equal is None or signal.name not in equal:
                    continue
                meant = replace(signal, name=equal[signal.name])
            fits = [column for column in free if _fits(meant, column, how, open_signals)]
            if len(fits) == 1:
                found[signal.name] = Match(signal, fits[0].name, how)
                free.remove(fits[0])
    left = [signal for signal in signals if signal.name not in found]
    if len(left) == len(free) == 1 and _may_be(left[0], free[0]):
        found[left[0].name] = Match(left[0], free[0].name, "being the only one left")
    return [found.get(signal.name, Match(signal, None, None)) for signal in signals]


def _described_pairs(
    signals: Sequence[Signal], columns: Sequence[Column], described: Mapping[str, str]
) -> list[tuple[Signal, Column]]:
    """Signals and columns that name each other best: of the words of the description and of the name, more
    stand in the name of the column than in that of any other that the signal may be, and than any other
    signal has there."""
    if not signals or not columns:
        return []
    words = [(_telling(one.name), _telling(described.get(one.name, ""))) for one in signals]
    parts = [_words(stem(column)) for column in columns]
    shared = np.array([[_n_shared(*own, others) for others in parts] for own in words])
    for i, k in np.argwhere(shared):
        shared[i, k] *= _may_be(signals[i], columns[k])
    most = [(shared == shared.max(axis, keepdims=True)) & (shared > 0) for axis in (0, 1)]
    is_alone = [one & (one.sum(axis, keepdims=True) == 1) for axis, one in enumerate(most)]
    return [(signals[i], columns[k]) for i, k in np.argwhere(is_alone[0] & is_alone[1])]


def _telling(text: str) -> set[str]:
    return {word for word in _words(text) if len(word) >= TELLING_LETTERS or _is_code(word)}


def _is_code(word: str) -> bool:
    """Whether a word is the name of a channel or terminal, of letters and a number (`ch1`, `ai3`)."""
    return re.fullmatch(r"[a-z]+\d+", word) is not None


def _n_shared(named: set[str], described: set[str], parts: set[str]) -> int:
    """How many telling words of the name and the description of a signal stand in the `parts` of the name of
    a column; those of its description also as a part of a longer one, but for the name of a channel."""
    whole = (named | {word for word in described if _is_code(word)}) & parts
    words = {word for word in described - whole if not _is_code(word)}
    return len(whole) + sum(any(word in part for part in parts) for word in words)


def _fits(signal: Signal, column: Column, how: How, others: Sequence[Signal]) -> bool:
    if how == "name":
        return signal.name in (column.name, column.header)
    if how in ("similar name", "name of what it equals"):
        names = {column.name.lower(), column.name.rsplit("_", 1)[0].lower(), stem(column).lower()}
        is_same = signal.name.lower() in names or signal.name.rsplit(".", 1)[-1].lower() in names
        is_same = is_same or _is_element(signal.name, names) or _is_without_unit(signal, column)
        return is_same and (how == "similar name" or _may_be(signal, column))
    if how == "part of its name":
        is_part = _words(signal.name.rsplit(".", 1)[-1]) <= _words(stem(column))
        return is_part and _may_be(signal, column)
    rivals = [other for other in others if other is not signal and _same_kind(other.unit, signal.unit)]
    return not rivals and bool(signal.unit) and _same_kind(_told_unit(column, signal), signal.unit)


def _is_element(name: str, columns: set[str]) -> bool:
    """Whether `name` has an index, `T[1]`, and one of `columns` is it as tables write it, where brackets hold
    units: `T1`, `T_1`."""
    if "[" not in name:
        return False
    spelt = {_without_marks(name), _without_marks(name.rsplit(".", 1)[-1])}
    return any(_without_marks(column) in spelt for column in columns)


def _is_without_unit(signal: Signal, column: Column) -> bool:
    """Whether a signal whose name ends with its unit, `p1_bar`, is a column of such a unit called without it,
    `p1 [bar]`."""
    name, _, unit = signal.name.rpartition("_")
    is_unit = is_known_unit(unit) and _same_kind(unit, signal.unit)
    return is_unit and name.lower() == stem(column).lower() and _may_be(signal, column)


def _without_marks(name: str) -> str:
    return re.sub(r"[\W_]+", "", name.lower())


def _may_be(signal: Signal, column: Column) -> bool:
    """Whether the units of both do not differ in kind, as far as they are known."""
    unit = _told_unit(column, signal)
    return not unit or not signal.unit or _same_kind(unit, signal.unit)


def unitless_findings(table: Table, signals: Sequence[Signal]) -> list[Finding]:
    """A warning for every signal that has no unit in the model while its column has one: its values are taken
    as they stand."""
    findings = []
    for signal in signals:
        column = table.find(signal.header)
        unit = column_unit(column) if column is not None else ""
        if column is not None and unit not in ("", "1") and not signal.unit:
            text = (
                f"is in {unit}, but '{signal.name}' has no unit in the model: the values are taken as they "
                'stand; write (unit = "...") where the model declares it'
            )
            findings.append(Finding("check-unit-unknown", "warning", column.name, text))
    return findings


def clock_findings(table: Table, clock: str, name: str | None = None) -> list[Finding]:
    """A note where the column `name` of the time, or the only one, tells its unit, or holds dates: it is read
    in `clock`, another unit than seconds, in which the equations count time."""
    column = counted_column(table, clock, name)
    if column is None:
        return []
    text = f"is read in {clock}, in which the balances of the model count time, as its units tell"
    return [Finding("check-model-clock", "note", column.name, text)]


def _words(name: str) -> set[str]:
    return {word for word in re.split(r"[\W_]+", name.lower()) if word}


def _same_kind(given: str, wanted: str) -> bool:
    return bool(given and wanted) and converts(given, wanted)
