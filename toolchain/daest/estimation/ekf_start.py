"""Where the likelihood of the extended filter is searched from.

The end of a search by simulation is the natural start, but a simulation that leaves the record (a pendulum
that turns over once too often) ends anywhere, and leaves all its error to the measurement noise. The filter
follows the record from any start once its noise is wide enough: a few noise levels at both starts are
compared.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from daest.estimation.coordinates import Unknowns
from daest.estimation.search import Evaluation

PROCESS_LOGS = tuple(np.log([1.0, 1e-2, 1e2, 1e4]))  # of common factors of all searched intensities
STD_LOGS = tuple(np.log([1.0, 0.1, 0.01]))  # of all searched measurement standard deviations
LOST = np.log(1e-3)  # of its start: a logarithmic parameter below has no slope left to come back by


def best_start(
    objective: Callable[[np.ndarray, bool], Evaluation | None], unknowns: Unknowns, starts: list[np.ndarray]
) -> np.ndarray:
    """The start with the highest likelihood at one of the noise levels tried; the first one where the filter
    runs nowhere. `starts` are search vectors that begin with `unknowns`."""
    process, measurement = unknowns.of_kind("process"), unknowns.of_kind("measurement")
    factors = product(PROCESS_LOGS if process else (0.0,), STD_LOGS if measurement else (0.0,))
    tried = []
    for (by_process, by_std), start in product(factors, starts):
        z = start.copy()
        z[process] += by_process
        z[measurement] += by_std
        z[: unknowns.lower.size] = np.clip(z[: unknowns.lower.size], unknowns.lower, unknowns.upper)
        found = objective(z, False)
        if found is not None:
            tried.append((found.value, len(tried), z))
    return min(tried)[2] if tried else starts[0]


def with_lost_ones(unknowns: Unknowns, z: np.ndarray, given: np.ndarray) -> np.ndarray:
    """z with the logarithmic parameters that have run off towards zero back where the user started, as what
    drove them there may by now be known to be noise; z itself where there are none."""
    lost = [
        i
        for i, coordinate in enumerate(unknowns.coordinates)
        if coordinate.kind == "parameter" and coordinate.is_log and z[i] < given[i] + LOST
    ]
    if not lost:
        return z
    revived = z.copy()
    revived[lost] = given[lost]
    return revived
