"""A look at a recording before a model is fitted to it: its clock, its columns, and pairs of them; and, with
a model, whether an output moves against the simulated one for all parameter values.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from daest.data.faults import Samples, Series, absurd, clock_findings, column_findings, pair_findings
from daest.data.limits import DATA
from daest.data.read import find_time
from daest.data.table import Table, column_unit, in_seconds, unit_findings
from daest.errors import DaestError
from daest.model.experiment import ColumnSummary, DataCheck, Experiment, Finding, Role
from daest.model.flat import FlatModel, Model

ANGLES = {"rad": 2.0 * np.pi, "deg": 360.0, "°": 360.0, "rev": 1.0}  # units of one turn


@dataclass(frozen=True)
class _Column:
    name: str
    unit: str | None
    role: Role | None
    values: np.ndarray


def check_table(table: Table, roles: Mapping[str, Role] | None = None, time: str | None = None) -> DataCheck:
    """All columns of numbers in a file. `roles` says which columns (by name) are an input or an output of a
    model; `time` names the column of the time. Raises DataError where there is no time."""
    time_column = find_time(table, time)
    seconds = in_seconds(time_column)
    roles = roles or {}
    columns = [
        _Column(c.name, column_unit(c) or None, roles.get(c.name), c.values)
        for c in table.columns
        if c.name and c.name != time_column.name and len(c.texts) < c.values.size
    ]
    texts = [
        Finding("check-text", "warning", c.name, f"holds {len(c.texts)} text(s), {c.texts[0][1]!r} first")
        for c in table.columns
        if c.texts and c.name != time_column.name and (len(c.texts) < c.values.size or c.name in roles)
    ]
    return _checked(Path(table.file).stem, seconds, columns, [*unit_findings(time_column), *texts])


def check_experiment(experiment: Experiment) -> DataCheck:
    """The inputs and outputs of a recording.

    >>> daest.check_experiment(record).n_samples
    8000
    """
    inputs = zip(experiment.input_names, experiment.inputs.T, strict=True)
    outputs = zip(experiment.output_names, experiment.outputs.T, strict=True)
    columns = [_Column(name, None, "input", values) for name, values in inputs]
    columns += [_Column(name, None, "output", values) for name, values in outputs]
    return _checked(experiment.name, experiment.time, columns, [])


def _checked(name: str, time: np.ndarray, columns: Sequence[_Column], found: list[Finding]) -> DataCheck:
    findings = [*clock_findings(time), *found, *_few(time)]
    summaries = []
    for column in columns:
        known = np.isfinite(column.values) & np.isfinite(time)
        samples = Samples(column.name, column.role, time[known], column.values[known])
        summaries.append(_summary(column, samples))
        if samples.values.size:
            findings += [*column_findings(samples, int((~known).sum())), *_turned(column)]
        else:
            findings.append(Finding("check-missing", "warning", column.name, "holds no value"))
    findings += _pairs(time, columns)
    known_time = time[np.isfinite(time)]
    start, stop = (float(known_time[0]), float(known_time[-1])) if known_time.size else (0.0, 0.0)
    ordered = tuple(sorted(findings, key=lambda finding: finding.level != "warning"))
    return DataCheck(name, time.size, start, stop, _period(time), tuple(summaries), ordered)


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


def _summary(column: _Column, samples: Samples) -> ColumnSummary:
    given = samples.values
    low, high = (float(given.min()), float(given.max())) if given.size else (None, None)
    is_usual = ~absurd(given)
    usual = replace(samples, time=samples.time[is_usual], values=given[is_usual])
    several = usual.values.size > 1
    resolution = usual.resolution if several else None
    noise = usual.noise if several else None
    return ColumnSummary(column.name, column.unit, column.role, given.size, low, high, resolution, noise)


def _period(time: np.ndarray) -> float | None:
    steps = np.diff(time)
    if not steps.size or not np.all(steps > 0):
        return None
    step = float((time[-1] - time[0]) / steps.size)
    return float(f"{step:.9g}") if float(np.max(np.abs(steps - step))) < DATA.grid * step else None


def _pairs(time: np.ndarray, columns: Sequence[_Column]) -> list[Finding]:
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
    return pair_findings(series, period)


MOST_PARAMETERS = 8
LONGEST = 20_000  # samples of the recording that are simulated
UNITS = {  # how many times as large the numbers of one unit are as those of another one
    180.0 / np.pi: "degrees are beside radians",
    30.0 / np.pi: "turns a minute are beside rad/s",
    1e3: "one prefix of a unit is beside the next",
    1e5: "pascals are beside bars",
    1e6: "one prefix of a unit is beside the second next",
}
_MOVED = f"with its parameters up to {DATA.moved_parameter:g} times larger or smaller"


def model_findings(flat: Model, experiment: Experiment) -> list[Finding]:
    """What a model says of a recording: outputs that move against it, or the only input if all outputs do,
    and outputs that move with it and are as many times as large as another unit would make them.

    Nothing is said where the model cannot be simulated, or where it depends on the parameters.
    """
    part = _shortened(experiment)
    seen: list[np.ndarray] = []
    is_against = is_scaled = np.ones(len(part.output_names), dtype=bool)
    try:
        driven = _driven(flat)
        for theta in _variants(flat):
            correlations, ratios = here = _beside(driven, part, theta)
            seen.append(here)
            is_against = is_against & (correlations < -DATA.upside_down)  # not where it is NaN
            is_far = np.abs(np.log(ratios)) > np.log(DATA.other_scale)
            is_scaled = is_scaled & (correlations > DATA.upside_down) & is_far
            if not np.any(is_against | is_scaled):
                return []  # whatever the other parameter values give
    except DaestError:
        return []
    known = np.isfinite(np.stack(seen)[:, 0]).all(axis=0)
    return [*_against(part, is_against, int(known.sum())), *_scaled(part, is_scaled, seen[0][1])]


def _against(part: Experiment, is_against: np.ndarray, n_measured: int) -> list[Finding]:
    against = [name for name, found in zip(part.output_names, is_against, strict=True) if found]
    if len(against) == n_measured and len(against) > 1 and len(part.input_names) == 1:
        text = f"drives all {n_measured} outputs the other way than the model: probably its polarity"
        return [Finding("check-polarity", "warning", part.input_names[0], text)]
    text = f"moves against the model, {_MOVED}"
    return [Finding("check-polarity", "warning", name, text) for name in against]


def _scaled(part: Experiment, is_scaled: np.ndarray, ratios: np.ndarray) -> Iterator[Finding]:
    for name, found, ratio in zip(part.output_names, is_scaled, ratios, strict=True):
        size = max(ratio, 1.0 / ratio) if found else np.nan
        unit = next((u for f, u in UNITS.items() if abs(np.log(size / f)) < np.log(DATA.same_scale)), None)
        if unit is not None:
            times = f"{size:.3g} times as {'large' if ratio > 1.0 else 'small'}"
            yield Finding("check-scale", "warning", name, f"is {times} as in the model, {_MOVED}, as {unit}")


def _shortened(experiment: Experiment) -> Experiment:
    n = min(experiment.n_samples, LONGEST)
    return replace(
        experiment,
        time=experiment.time[:n],
        inputs=experiment.inputs[:n],
        outputs=experiment.outputs[:n],
        extra={},
    )


def _variants(flat: Model) -> Iterator[np.ndarray]:
    """The parameter values of the model, then with each unknown one larger and smaller."""
    theta = flat.theta_values
    yield theta
    unknown = [i for i, p in enumerate(flat.parameters) if p.estimate][:MOST_PARAMETERS]
    for i in unknown:
        for factor in (DATA.moved_parameter, 1.0 / DATA.moved_parameter):
            changed = theta.copy()
            changed[i] *= factor
            yield changed


def _driven(flat: Model) -> Any:
    """The model in the form by which it is driven, made once; with events the start decides on it."""
    from daest.systems.reduce import dynamics

    return flat if isinstance(flat, FlatModel) and flat.events is not None else dynamics(flat)


def _beside(driven: Any, experiment: Experiment, theta: np.ndarray) -> np.ndarray:
    """Correlation of every measured output with the simulated one, and how many times as large it is,
    (2, n_y); NaN where one of them stands still."""
    from daest.systems.simulate import simulate

    simulated = simulate(driven, experiment, theta=theta).outputs
    pairs = zip(experiment.outputs.T, simulated.T, strict=True)
    return np.array([_correlation(experiment.time, *pair) for pair in pairs]).T


def _correlation(time: np.ndarray, measured: np.ndarray, simulated: np.ndarray) -> tuple[float, float]:
    """Correlation and ratio of the sizes, without a trend: where both drift, they do so for other reasons."""
    known = np.isfinite(measured) & np.isfinite(simulated)
    if known.sum() < 3:
        return np.nan, np.nan
    basis = np.vander(time[known] - time[0], 2)
    rest = [v - basis @ np.linalg.lstsq(basis, v, rcond=None)[0] for v in (measured[known], simulated[known])]
    sizes = [float(np.linalg.norm(v)) for v in rest]
    if not min(sizes) > 0:
        return np.nan, np.nan
    return float(rest[0] @ rest[1] / (sizes[0] * sizes[1])), sizes[0] / sizes[1]
