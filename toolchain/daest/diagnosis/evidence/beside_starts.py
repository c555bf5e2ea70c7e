"""Simulations compared by what no start of either could do.

Records in pieces begin wherever they fit best, unseen ones too. Where a law lets a start last longer, or has
states of its own, that is a free curve for every piece, which takes from any error that is slow: a mass that
hangs on a spring swings as it likes, a shaft that creeps holds whatever twist it began with. So errors are
compared beside all that the starts of both models can do, which is the same for both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daest.diagnosis.evidence.free_starts import best_start
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import RTOL
from daest.model.experiment import Experiment
from daest.systems.events.integration import IntegrationError
from daest.systems.simulation.integrate import integrate, integrator


@dataclass(frozen=True)
class Started:
    """The simulation of a record from its best start, by state: its errors (n_samples, n_y), and the
    directions (n_samples, n_y, n) in which another start moves its outputs."""

    errors: np.ndarray
    directions: np.ndarray
    start: Mapping[str, float]


def started(
    null: Null, experiments: Sequence[Experiment], others: Sequence[Started] = ()
) -> tuple[Started, ...] | None:
    """The simulation of every experiment, loads at rest; None where one cannot be made. What it owes to
    starting elsewhere than one of the `others`, a model without its law, is a direction, too: a law that
    bends does more with its start than the slopes there tell."""
    model, names = integrator(null.explicit), null.explicit.state_names
    loads = {load.name for load in null.loads}
    free = [i for i, name in enumerate(names) if name not in loads]
    still, root = np.zeros((len(names), len(null.flat.outputs))), np.diag(1.0 / null.measurement_std)
    found = []
    for number, experiment in enumerate(experiments):
        time, inputs = experiment.time, experiment.inputs
        try:
            x0 = best_start(null, model, experiment, still, root)
            run = integrate(
                model, time, inputs, null.theta, x0, hold=null.hold, sensitivities=True, rtol=RTOL
            )
            directions = run.sensitivities[:, :, free]
            if others:
                begun = others[number].start
                other = np.array([begun.get(name, 0.0) for name in names])
                moved = integrate(model, time, inputs, null.theta, other, hold=null.hold, rtol=RTOL)
                directions = np.dstack([directions, run.outputs - moved.outputs])
        except IntegrationError:
            return None
        start = dict(zip(names, x0.tolist(), strict=True))
        found.append(Started(experiment.outputs - run.outputs, directions, start))
    return tuple(found)


def beside_starts(
    before: Sequence[Started], after: Sequence[Started], size: np.ndarray
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """The errors (n_samples, n_y) of two simulations of the same records without what the starts of either
    can do, by least squares relative to the `size` (n_y,) of the errors of each output; without the records
    of which the starts can do as much as is left."""
    found = (_without_starts(*pair, size) for pair in zip(before, after, strict=True))
    pairs = [pair for pair in found if pair is not None]
    return tuple(one for one, _ in pairs), tuple(other for _, other in pairs)


def _without_starts(one: Started, other: Started, size: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    table = np.dstack([one.directions, other.directions]) / size[:, None]
    known = np.isfinite(one.errors)
    if not (np.isfinite(table).all() and np.isfinite(other.errors[known]).all()):
        return one.errors, np.full_like(other.errors, np.nan)  # it ran away
    slopes = np.where(known[:, :, None], table, 0.0).reshape(known.size, -1)
    lengths = np.linalg.norm(slopes, axis=0)
    basis, values, _ = np.linalg.svd(slopes[:, lengths > 0.0] / lengths[lengths > 0.0], full_matrices=False)
    basis = basis[:, values > GATES.nuisance_rank * np.max(values, initial=0.0)]
    if basis.shape[1] >= GATES.max_started * np.count_nonzero(known):
        return None

    def left(errors: np.ndarray) -> np.ndarray:
        course = np.where(known, errors / size, 0.0).ravel()
        rest = (course - basis @ (basis.T @ course)).reshape(known.shape)
        return np.where(known, rest * size, np.nan)

    return left(one.errors), left(other.errors)
