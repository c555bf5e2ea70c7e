"""Signals that come late, seen in the innovations of the null.

A lag or a dead time has no derivative where it vanishes. But of one at a signal the whole response is known
without: what the signal would be, late, less what it is, through the null's observer. A simulation sees late
signals, too; its errors, however, are those of what drifts slowly, and hide a lag of a heater behind what a
wall does over a day.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.data.prepare import bridged
from daest.diagnosis.built_in.dead_times import DELAY
from daest.diagnosis.built_in.trials import Trial
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, period_of
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.candidates import explicit_at_null
from daest.diagnosis.screening.responses import (
    entries_along,
    innovation_responses,
    loads_rescaled,
    nuisance,
    size_names,
)
from daest.diagnosis.screening.scores import scored
from daest.diagnosis.screening.screen import already_there
from daest.diagnosis.screening.size_slopes import sizes_of
from daest.model.diagnosis import Candidate, Screen, Screened
from daest.model.effects import Site
from daest.modelica.effects.catalogue import find_effect
from daest.numerics.recursions import varying_recursion
from daest.systems.simulation.integrate import interval_inputs

LAG = "Daest.Effects.Signals.Lag"
SECOND_ORDER = "Daest.Effects.Signals.SecondOrderLag"
TIMES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # sampling periods by which a signal is taken to be late
HAIR = 1e-9  # of an interval
MOST_LATE = 2  # trials of one kind go to the proof


def is_late(candidate: Candidate) -> bool:
    """Whether its law is that a signal comes late."""
    return candidate.effect.class_name in (LAG, DELAY)


@dataclass(frozen=True)
class LateSignals:
    """Trials of the `lags` that the innovations show, best first, each at the time that shows most, and of
    the `dead_times` at those signals that show more than the lag there."""

    lags: tuple[Trial, ...] = ()
    dead_times: tuple[Trial, ...] = ()


def late_signals(null: Null, run: NullObserver, candidates: Sequence[Candidate]) -> LateSignals:
    """Which of the candidates that delay a signal the innovations show; of signals that the sensors see alike
    the one that shows most."""
    late = [c for c in candidates if is_late(c) and c.is_of_recorded]
    late = [c for c, there in zip(late, already_there(null, late), strict=True) if not there]
    if not late:
        return LateSignals()
    times = [share * period_of(null.experiments) for share in TIMES]
    shaped = [replace(c, name=f"{c.name}_{i + 1}") for c in late for i in range(len(times))]
    trial_of = {
        one.name: Trial(late[i // len(times)], (times[i % len(times)],), ()) for i, one in enumerate(shaped)
    }
    directions = nuisance(run, len(null.estimated))
    found = scored(
        shaped,
        [slice(i, i + 1) for i in range(len(shaped))],
        run.whitened,
        directions,
        np.vstack([directions, loads_rescaled(null, run)]),
        late_responses(null, run, late, times),
        (),
        seed=0,
    )
    return _chosen(found, trial_of)


def _chosen(found: Screen, trial_of: Mapping[str, Trial]) -> LateSignals:
    kinds = [entry.candidate.effect.class_name for entry in found.entries]
    chosen: dict[str, list[Trial]] = {LAG: [], DELAY: []}
    taken: set[int] = set()
    for i, entry in enumerate(found.entries):
        if len(chosen[LAG]) == MOST_LATE or entry.absorbed or entry.p_value > GATES.screen_level:
            break
        if i in taken or not _is_late(entry, trial_of):
            continue
        own = [j for j, other in enumerate(found.entries) if other.candidate.site == entry.candidate.site]
        alike = [j for j in range(len(kinds)) if _is_alike(found, i, j)]
        taken.update(own, alike)
        lag = i if kinds[i] == LAG else next((j for j in own if kinds[j] == LAG), i)
        for j in dict.fromkeys((lag, i)):
            trial = trial_of[found.entries[j].candidate.name]
            places = {
                found.entries[k].candidate.site.name: trial_of[found.entries[k].candidate.name].candidate
                for k in range(len(kinds))
                if k not in own and kinds[k] == kinds[j] and _is_alike(found, j, k)
            }
            chosen[kinds[j]].append(replace(trial, alike=tuple(places.values())))
    return LateSignals(tuple(chosen[LAG]), tuple(chosen[DELAY]))


def _is_late(entry: Screened, trial_of: Mapping[str, Trial]) -> bool:
    """Whether the innovations show the response of the late signal as large as it is, or as that of one that
    is late by less than any of the times; not, as a slow signal has it, a little of a response to much."""
    shortest = min(trial.sizes[0] for trial in trial_of.values())
    is_shortest = trial_of[entry.candidate.name].sizes[0] == shortest
    return is_shortest or entry.sizes[0] >= GATES.min_late_share


def _is_alike(found: Screen, i: int, j: int) -> bool:
    return bool(abs(found.correlation[i, j]) > GATES.same_place_correlation)


def late_responses(
    null: Null, run: NullObserver, late: Sequence[Candidate], times: Sequence[float]
) -> np.ndarray:
    """Responses (k, m) of the whitened innovations to each candidate, a lag or a dead time at a signal, at
    each of the times [s]. Those of an output are of the one that the observer foresees."""
    offset = find_effect("Signals.Offset")
    shifted = [replace(c, effect=offset, name=f"late_{i + 1}") for i, c in enumerate(late)]
    names = [name for c in shifted for name in size_names(c)]
    explicit = explicit_at_null(null.flat, shifted)
    parts = []
    for number, entries in enumerate(entries_along(null, run, explicit, sizes_of(explicit, names))):
        experiment, rows = null.experiments[number], []
        for i, candidate in enumerate(late):
            ends, shown = entries.of(range(i, i + 1))
            course = _course(null, run, number, candidate.site)
            behind = _lags if candidate.effect.class_name == LAG else _shifts
            changes = np.stack([*behind(experiment.time, course, times)]) - course
            whole = np.concatenate([changes[:, 0], changes[:, 1, -1:]], axis=1)
            drive, direct = ends * changes[..., None], shown * whole[..., None]
            rows.append(innovation_responses(run, number, experiment, drive, direct))
        parts.append(np.concatenate(rows))
    return np.concatenate(parts, axis=1)


def _course(null: Null, run: NullObserver, number: int, site: Site) -> np.ndarray:
    """A signal of one experiment at both ends of all intervals, (2, n_samples - 1)."""
    experiment = null.experiments[number]
    if site.kind == "input":
        column = null.flat.input_names.index(site.name)
        ends = interval_inputs(null.explicit, experiment.time, experiment.inputs, null.hold)
        return np.stack([end[:, column] for end in ends])
    column = null.flat.output_names.index(site.name)
    error = run.observed[number].whitened @ np.linalg.inv(run.root).T
    foreseen = bridged(experiment.outputs - error, ~np.isfinite(experiment.outputs))[:, column]
    return np.stack([foreseen[:-1], foreseen[1:]])


def _lags(time: np.ndarray, course: np.ndarray, times: Sequence[float]) -> Iterator[np.ndarray]:
    """A signal (2, n_samples - 1) behind a first-order lag of each of the times, at both ends of all
    intervals as it is given there; it starts at rest."""
    (start, end), steps = course, np.diff(time)
    for T in times:
        # T y' = u - y where u runs straight from u_0 to u_1 with slope s over h:
        # y_1 = u_1 - s T + (y_0 - u_0 + s T) exp(-h / T).
        decay, ahead = np.exp(-steps / T), (end - start) / steps * T
        drive = end - ahead + (ahead - start) * decay
        value = varying_recursion(decay[:, None, None], drive[None, :, None], start[0])[0, :, 0]
        yield np.stack([value[:-1], value[1:]])


def _shifts(time: np.ndarray, course: np.ndarray, times: Sequence[float]) -> Iterator[np.ndarray]:
    """A signal (2, n_samples - 1) as it was each of the times ago, at both ends of all intervals; before the
    first sample it was as it is there."""
    at = np.stack([time[:-1], time[1:] - HAIR * np.diff(time)])  # apart where the signal jumps
    for T in times:
        yield np.interp(at - T, at.T.ravel(), course.T.ravel())
