"""Laws that unknown loads say in their place.

A load that is slow beside the recording takes a constant torque, or the drift of a sensor, and innovations
show nothing of it: one sample ahead, a load that stays as it is is as good as a law. But the loads that the
observer comes to are then those that the law makes it see, all along the recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daest.diagnosis.built_in.trials import Trial, trials
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.candidates import in_models
from daest.diagnosis.screening.responses import entries_along, size_names, some_at_a_time
from daest.diagnosis.screening.scores import projection
from daest.diagnosis.screening.size_slopes import sizes_of
from daest.model.diagnosis import Candidate, Screen
from daest.model.flat import ExplicitModel

MOST_SAID = 3  # trials go to the proof


def said_by_loads(null: Null, run: NullObserver, found: Screen) -> tuple[Trial, ...]:
    """Of the screened laws those that account for all loads by their sizes alone, best first."""
    if not null.loads:
        return ()
    known = [i for i, entry in enumerate(found.entries) if _has_sizes_alone(entry.candidate)]
    told = dict(zip(known, _regressed(null, run, [found.entries[i].candidate for i in known]), strict=True))
    said = [i for i in known if told[i][0] > GATES.min_said_by_loads]
    order = sorted(said, key=lambda i: -told[i][0])
    entries = tuple(replace(found.entries[i], p_value=0.0, sizes=told[i][1]) for i in order)
    return trials(replace(found.only(order), entries=entries), GATES.screen_level, MOST_SAID)


def _has_sizes_alone(candidate: Candidate) -> bool:
    effect = candidate.effect
    has_states = candidate.is_dynamic or effect.n_states
    return not has_states and not any(p.role == "shape" for p in effect.parameters)


def _regressed(
    null: Null, run: NullObserver, candidates: Sequence[Candidate]
) -> list[tuple[float, tuple[float, ...]]]:
    """Of each candidate the share of the squares of the loads, as the observer predicts them in the first
    experiment, that the law explains at its best sizes, and these: beyond what other parameters and another
    start would do to them. Every load counts by its size."""
    if not candidates:
        return []
    n_samples, dynamics = null.experiments[0].n_samples, run.dynamics[0]
    rows = [run.state_names.index(load.name) for load in null.loads]
    weights = np.array([1.0 / load.size if load.size > 0.0 else 0.0 for load in null.loads])

    def course(states: np.ndarray) -> np.ndarray:
        return (states[..., rows] * weights).reshape(*states.shape[:-2], -1)

    def made(explicit: ExplicitModel, names: Sequence[str]) -> np.ndarray:
        entries = next(entries_along(null, run, explicit, sizes_of(explicit, names)))
        found = np.empty((len(names), n_samples * len(rows)))
        for several in some_at_a_time(len(names), n_samples * entries.n_states):
            # What is missing in the model is what the loads stand for: their errors, were it there.
            found[several] = -course(dynamics.state_errors(*entries.of(several)))
        return found

    directions = [course(dynamics.from_start(n_samples)), made(null.explicit, null.estimated)]
    apart = projection(np.concatenate(directions))
    (loads,), (share,) = apart(course(run.observed[0].predicted)[None])
    if share < GATES.same_slopes:  # rounding: parameters and starts do all that the loads do
        return [(0.0, ())] * len(candidates)
    said: dict[str, tuple[float, tuple[float, ...]]] = {}
    for together, explicit in in_models(null.flat, candidates):
        laws, first = apart(made(explicit, [name for c in together for name in size_names(c)]))[0], 0
        for candidate in together:
            own = laws[first : first + len(candidate.effect.sizes)].T
            first += own.shape[1]
            sizes = np.linalg.lstsq(own, loads, rcond=None)[0]
            left = float(np.sum((loads - own @ sizes) ** 2) / np.sum(loads**2))
            said[candidate.name] = (1.0 - left, tuple(sizes.tolist()))
    return [said.get(candidate.name, (0.0, ())) for candidate in candidates]
