"""A look at a recording before a model is fitted to it: its clock, its columns, and pairs of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daest.data.faults import (
    Samples,
    Series,
    absurd,
    clock_findings,
    column_findings,
    displaced,
    equal_runs,
    excursions,
    no_reading_yet,
    pair_findings,
)
from daest.data.interpolated import interpolated
from daest.data.limits import DATA
from daest.data.prepare import whole_period
from daest.data.read import find_time
from daest.data.table import Column, Table, column_unit, in_seconds, unit_findings
from daest.model.experiment import ColumnSummary, DataCheck, Experiment, Finding, Role
from daest.quantities import converts

OFF_ALREADY = ("check-outliers", "check-dropouts", "check-saturation", "check-stuck")  # of the same values
ANGLES = {"rad": 2.0 * np.pi, "deg": 360.0, "°": 360.0, "rev": 1.0}  # units of one turn


@dataclass(frozen=True)
class _Column:
    name: str
    unit: str | None
    role: Role | None
    values: np.ndarray


def check_table(
    table: Table,
    roles: Mapping[str, Role] | None = None,
    time: str | None = None,
    clock: str = "s",
    units: Mapping[str, str] | None = None,
) -> DataCheck:
    """All columns of numbers in a file. `roles` says which columns (by name) are an input or an output of a
    model, and `units` in what the model has them; `time` names the column of the time. Raises DataError where
    there is no time."""
    time_column = find_time(table, time)
    seconds = in_seconds(time_column)
    roles, units = roles or {}, units or {}
    columns = [
        _Column(c.name, _unit(c, units.get(c.name)), roles.get(c.name), c.values)
        for c in table.columns
        if c.name and c.name != time_column.name and len(c.texts) < c.values.size
    ]
    texts = [
        Finding("check-text", "warning", c.name, f"holds {len(c.texts)} text(s), {c.texts[0][1]!r} first")
        for c in table.columns
        if c.texts and c.name != time_column.name and (len(c.texts) < c.values.size or c.name in roles)
    ]
    return _checked(Path(table.file).stem, seconds, columns, [*unit_findings(time_column), *texts], clock)


def _unit(column: Column, of_model: str | None) -> str | None:
    """The unit of a column; none that its name ends with where the model has another kind of quantity: a
    temperature `T_in` is in no inches."""
    unit = column_unit(column)
    is_ending = column.unit is None and of_model is not None
    return None if is_ending and not converts(unit, of_model or "") else unit or None


def mostly_copied(experiment: Experiment) -> list[Finding]:
    """The outputs most of which are the same as an input to the last digit."""
    return [
        f for f in _copied(experiment.time, _columns_of(experiment)) if 2 * f.count > experiment.n_samples
    ]


def check_experiment(
    experiment: Experiment, clock: str = "s", units: Mapping[str, str] | None = None
) -> DataCheck:
    """The inputs and outputs of a recording, whose time is in `clock`; `units` those of its outputs, which
    tell angles.

    >>> daest.check_experiment(record).n_samples
    8000
    """
    return _checked(experiment.name, experiment.time, _columns_of(experiment, units), [], clock)


def _columns_of(experiment: Experiment, units: Mapping[str, str] | None = None) -> list[_Column]:
    units = units or {}
    inputs = zip(experiment.input_names, experiment.inputs.T, strict=True)
    outputs = zip(experiment.output_names, experiment.outputs.T, strict=True)
    columns = [_Column(name, None, "input", values) for name, values in inputs]
    return columns + [_Column(name, units.get(name), "output", values) for name, values in outputs]


def _checked(
    name: str, time: np.ndarray, columns: Sequence[_Column], found: list[Finding], clock: str
) -> DataCheck:
    findings = [*clock_findings(time, clock), *found, *_few(time)]
    summaries, driven = [], _driven(columns)
    for column in columns:
        known = np.isfinite(column.values) & np.isfinite(time)
        samples = Samples(column.name, column.role, time, column.values, driven, clock).part(known)
        summaries.append(_summary(column, samples))
        if samples.values.size:
            of_column = column_findings(samples, int((~known).sum()))
            if not any(one.code in OFF_ALREADY for one in of_column):
                others = [c.values[known] for c in columns if c is not column]
                of_column += no_reading_yet(samples, others)
                of_column += displaced(samples, others) or excursions(samples, others)
                of_column += interpolated(samples, others)
            findings += [*of_column, *_turned(column), *_wrapped(column)]
        else:
            findings.append(Finding("check-missing", "warning", column.name, "holds no value"))
    findings += [
        *_changed_unseen(time, columns, clock),
        *_copied(time, columns),
        *_pairs(time, columns, clock),
    ]
    known_time = time[np.isfinite(time)]
    start, stop = (float(known_time[0]), float(known_time[-1])) if known_time.size else (0.0, 0.0)
    ordered = tuple(sorted(findings, key=lambda finding: finding.level != "warning"))
    return DataCheck(name, time.size, start, stop, _period(time), tuple(summaries), ordered, clock)


def _few(time: np.ndarray) -> list[Finding]:
    if time.size >= DATA.told_samples:
        return []
    text = (
        f"has {time.size} samples: too few to tell faults from the signal, or to estimate more than one or "
        "two parameters"
    )
    return [Finding("check-few-samples", "warning", None, text, subject="the recording")]


def _turned(column: _Column) -> list[Finding]:
    """A remark on an angle that has gone round many times."""
    if column.unit not in ANGLES:
        return []
    known = column.values[np.isfinite(column.values) & ~absurd(column.values)]
    turns = float(np.ptp(known)) / ANGLES[column.unit] if known.size else 0.0
    if turns < DATA.many_turns:
        return []
    text = (
        f"has turned {turns:.0f} times: errors of the speed add up in it, and a simulation drifts away; "
        "measure the speed, or estimate from one-step predictions (--method pem)"
    )
    return [Finding("check-turns", "note", column.name, text)]


def _wrapped(column: _Column) -> list[Finding]:
    """A warning of an angle that begins again after a turn: between the jumps, which are longer than three
    quarters of a turn, it goes in steps of less than a quarter, and across them no further than there. A
    command that switches between two angles stands still in between."""
    if column.unit not in ANGLES or column.role == "input":
        return []
    turn = ANGLES[column.unit]
    known = column.values[np.isfinite(column.values) & ~absurd(column.values)]
    steps = np.abs(np.diff(known)) / turn
    jumps = steps > 1.0 - DATA.wrapped_step
    between = steps[~jumps]
    if not np.any(jumps) or not between.size or np.ptp(known) > turn or between.max() > DATA.wrapped_step:
        return []
    if np.median(1.0 - steps[jumps]) > between.max():
        return []
    text = (
        f"jumps by a turn {np.count_nonzero(jumps)} time(s), from {known.max():.4g} to {known.min():.4g} or "
        "back: the angle of a model counts on; unwrap it (numpy.unwrap, unwrap of MATLAB)"
    )
    return [Finding("check-wrapped", "warning", column.name, text)]


def _driven(columns: Sequence[_Column]) -> np.ndarray | None:
    """When an input was not zero, (n,) of bool; a missing value may be anything. None without inputs."""
    inputs = [column.values for column in columns if column.role == "input"]
    return np.any([values != 0.0 for values in inputs], axis=0) if inputs else None


def _changed_unseen(time: np.ndarray, columns: Sequence[_Column], clock: str) -> list[Finding]:
    """Inputs that change by much of their range while the clock pauses: nobody knows when."""
    steps = np.diff(time)
    if steps.size < 2 or not np.all(steps > 0):
        return []
    gaps = np.flatnonzero(steps > DATA.unseen_pause * np.median(steps))
    found = []
    for column in columns if gaps.size else ():
        values = column.values
        if column.role != "input" or not np.all(np.isfinite(values)) or np.any(absurd(values)):
            continue
        changes = np.abs(values[gaps + 1] - values[gaps])
        large = gaps[changes > DATA.unseen_change * np.ptp(values)]
        if not large.size:
            continue
        at = int(large[0])
        text = (
            f"changes from {values[at]:.4g} to {values[at + 1]:.4g} while the clock pauses for "
            f"{steps[at]:.4g} {clock}: when is unknown, and it is taken as held or as a straight line; "
            "cut the recording there, or make two of it"
        )
        found.append(Finding("check-input-unseen", "warning", column.name, text, float(time[at]), large.size))
    return found


def _copied(time: np.ndarray, columns: Sequence[_Column]) -> list[Finding]:
    """Outputs that are the same as an input, to the last digit, in stretches in which both move: cells of one
    were filled in from the other. A column that is a copy as a whole is told elsewhere."""
    found = []
    for output in (c for c in columns if c.role == "output"):
        for given in (c for c in columns if c.role == "input"):
            is_same = output.values == given.values
            runs = [
                (first, length)
                for first, length in zip(*equal_runs(is_same), strict=True)
                if length >= DATA.repeated_stretch
                and is_same[first]
                and np.unique(output.values[first : first + length]).size >= DATA.repeated_rows
            ]
            if runs and not np.all(is_same):
                count = int(sum(length for _, length in runs))
                text = (
                    f"is the same as the input {given.name} to the last digit in {count} samples "
                    f"({count / time.size:.0%}), while both move: one was filled in from the other, and "
                    "there the model is driven by what it is compared with"
                )
                at = float(time[runs[0][0]])
                found.append(Finding("check-copied", "warning", output.name, text, at, count))
    return found


def _summary(column: _Column, samples: Samples) -> ColumnSummary:
    given = samples.values
    low, high = (float(given.min()), float(given.max())) if given.size else (None, None)
    is_usual = ~absurd(given)
    usual = samples.part(is_usual)
    several = usual.values.size > 1
    resolution = usual.resolution if several else None
    noise = usual.noise if several else None
    return ColumnSummary(column.name, column.unit, column.role, given.size, low, high, resolution, noise)


def _period(time: np.ndarray) -> float | None:
    steps = np.diff(time)
    if not steps.size or not np.all(steps > 0):
        return None
    step = float((time[-1] - time[0]) / steps.size)
    is_uniform = float(np.max(np.abs(steps - step))) < DATA.grid * step
    return float(f"{step:.9g}") if is_uniform else whole_period(time)


def _pairs(time: np.ndarray, columns: Sequence[_Column], clock: str) -> list[Finding]:
    steps = np.diff(time)
    if time.size < 2 or not np.all(steps > 0):
        return []
    period = float(np.median(steps))
    length = float(time[-1]) / period - float(time[0]) / period
    if not length < 4 * time.size:  # a pause longer than the recording, or a time beyond all numbers
        return []
    n = int(length) + 1
    grid = time[0] + period * np.arange(n)
    series = [
        Series(c.name, c.unit or "", np.interp(grid, time, c.values))
        for c in columns
        if np.all(np.isfinite(c.values)) and not np.any(absurd(c.values))
    ]
    return pair_findings(series, period, clock)
