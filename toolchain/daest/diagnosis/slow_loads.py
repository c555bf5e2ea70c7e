"""Laws that an unknown load says in their place.

A load that is slow beside the recording takes a constant torque, and the innovations show nothing of it: one
sample ahead, a load that stays as it is is as good as a law. But smoothed over the whole recording, the load
is what the law says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daest.diagnosis.candidates import explicit_at_null
from daest.diagnosis.disturbance import SmoothedLoad
from daest.diagnosis.gates import GATES
from daest.diagnosis.null import Null
from daest.diagnosis.screen import NullObserver, entries_along, size_names
from daest.diagnosis.trials import Trial, trials
from daest.model.diagnosis import Candidate, Screen

MOST_SAID = 1  # trial goes to the proof


def said_by_load(
    null: Null, run: NullObserver, load: SmoothedLoad | None, found: Screen
) -> tuple[Trial, ...]:
    """Of the screened laws at the place of the load those that are all of its course, smoothed, by sizes
    alone; the one that says most first."""
    if load is None:
        return ()
    places = null.loads[load.index].places
    known = [
        i
        for i, entry in enumerate(found.entries)
        if entry.candidate.site.name in places and not entry.candidate.shape
    ]
    told = _regressed(null, run, load, [found.entries[i].candidate for i in known])
    least = GATES.min_said_by_load
    order = sorted((i for i in range(len(known)) if told[i][0] > least), key=lambda i: -told[i][0])
    entries = tuple(replace(found.entries[known[i]], sizes=told[i][1]) for i in order)
    rows = [known[i] for i in order]
    return trials(
        replace(found, entries=entries, correlation=found.correlation[np.ix_(rows, rows)]), 1.0, MOST_SAID
    )


def _regressed(
    null: Null, run: NullObserver, load: SmoothedLoad, candidates: Sequence[Candidate]
) -> list[tuple[float, tuple[float, ...]]]:
    """Of each candidate the share of the squares of the load's course, in the first experiment, that it says
    at its best sizes, and these."""
    if not candidates:
        return []
    names = [name for candidate in candidates for name in size_names(candidate)]
    entries = next(entries_along(null, run, explicit_at_null(null.flat, candidates), names))
    drives = entries.of(range(len(names)))[0][:, 0]
    row = run.state_names.index(null.loads[load.index].name)
    entry = run.average.A[:, row].copy()
    entry[row] = 0.0  # the load's own decay
    course = (load.values[:-1, None] * entry).ravel()
    result, first = [], 0
    for candidate in candidates:
        own = drives[first : first + len(candidate.effect.sizes)]
        first += len(own)
        table = own.reshape(len(own), -1).T
        sizes = np.linalg.lstsq(table, course, rcond=None)[0]
        left = float(np.sum((course - table @ sizes) ** 2) / np.sum(course**2))
        result.append((1.0 - left, tuple(sizes.tolist())))
    return result
