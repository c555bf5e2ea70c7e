"""Where the likelihood of the extended filter is searched from.

The end of a search by simulation or with an observer is the natural start, but it may have lost a noise or a
parameter: a simulation that leaves the record (a pendulum that turns over once too often) ends anywhere and
leaves all its error to the measurement noise, and an observer may take friction for damping and the rest for
measurement noise. The filter follows the record from any start once its noise is wide enough: a few noise
levels at every start are compared, first with a common factor, then pair by pair: a process noise and the
measurement noise that took its place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines.ekf import run_ekf
from daest.estimation.filter_engines.filter_task import Noise, Record, Start
from daest.estimation.fitting.coordinates import Unknowns, lost_ones
from daest.estimation.fitting.search import Evaluation
from daest.systems.events.integration import IntegrationError
from daest.systems.simulation.local_linear import LocalModel

PROCESS_LOGS = tuple(np.log([1.0, 1e-2, 1e2, 1e4]))  # of common factors of all searched intensities
STD_LOGS = tuple(np.log([1.0, 0.1, 0.01]))  # of all searched measurement standard deviations
PAIR_LOGS = tuple(product(np.log([1.0, 1e-2, 1e2, 1e4, 1e6]), np.log([1.0, 0.2, 3.0])))  # of one of each
FELT_SAMPLES = 5
NO_SPREAD = 1e-20

Objective = Callable[[np.ndarray, bool], Evaluation | None]


def best_start(objective: Objective, unknowns: Unknowns, starts: list[np.ndarray]) -> np.ndarray:
    """The start with the highest likelihood at the noise levels tried; the first one where the filter runs
    nowhere. `starts` are search vectors that begin with `unknowns`. All of them have the shape (n_z,)."""
    process, measurement = unknowns.of_kind("process"), unknowns.of_kind("measurement")
    factors = product(PROCESS_LOGS if process else (0.0,), STD_LOGS if measurement else (0.0,))
    changes = []
    for by_process, by_std in factors:
        change = np.zeros(len(unknowns.coordinates))
        change[process], change[measurement] = by_process, by_std
        changes.append(change)
    best = _best(objective, unknowns, [(start, change) for change in changes for start in starts])
    if best is None:
        return starts[0]
    unit = np.eye(len(unknowns.coordinates))
    for i, j in product(process, measurement):
        tried = [(best, by_process * unit[i] + by_std * unit[j]) for by_process, by_std in PAIR_LOGS]
        best = _best(objective, unknowns, tried)
        assert best is not None
    return best


def _best(
    objective: Objective, unknowns: Unknowns, tried: list[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray | None:
    """Of the starts with changes of their unknowns; None where there is no value."""
    found: tuple[float, np.ndarray] | None = None
    for start, change in tried:
        z = start.copy()
        z[: change.size] = np.clip(z[: change.size] + change, unknowns.lower, unknowns.upper)
        here = objective(z, False)
        if here is not None and (found is None or here.value < found[0]):
            found = (here.value, z)
    return None if found is None else found[1]


def felt_intensity(
    model: LocalModel, data: Record, theta: np.ndarray, x0: np.ndarray, std: np.ndarray
) -> np.ndarray:
    """Intensity of each noise (n_w,) that moves some output by its standard deviation within FELT_SAMPLES; 1
    where it moves none or the model cannot run."""
    head = Record(*(part[:FELT_SAMPLES] for part in (data.time, data.u0, data.u1, data.outputs)))
    head = replace(head, outputs=np.full_like(head.outputs, np.nan))
    start = Start(x0, np.zeros((x0.size, x0.size)))
    felt = np.ones(model.n_noises)
    for i in range(felt.size):
        # So little noise that nothing is averaged over it.
        noise = Noise(NO_SPREAD * np.eye(felt.size)[i], np.ones(std.size))
        try:
            run = run_ekf(model, head, theta, noise, start)
        except (IntegrationError, EstimationError):
            continue
        moved = np.einsum("kyi,kij,kyj->ky", run.sight, run.predicted_cov, run.sight) / NO_SPREAD
        largest = float(np.max(moved / std**2, initial=0.0))
        felt[i] = 1.0 / largest if largest > 0.0 else 1.0
    return felt


def with_lost_ones(unknowns: Unknowns, z: np.ndarray, given: np.ndarray) -> np.ndarray:
    """z with the parameters that a search has lost back where the user started, as what drove them there
    may by now be known to be noise; z itself where there are none. Shapes: z and given (n_z,)."""
    lost = lost_ones(unknowns, z, given)
    if not lost:
        return z
    revived = z.copy()
    revived[lost] = given[lost]
    return revived
