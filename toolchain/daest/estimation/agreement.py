"""Agreement of a fitted model with recordings: simulation from the best initial state, and one-step
prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daest.estimation import likelihood, output_error
from daest.estimation.output_error import Problem
from daest.estimation.predictor import Innovations
from daest.estimation.records import Record
from daest.model.fit import Agreement


def simulated_agreement(problem: Problem, records: tuple[Record, ...], z: np.ndarray) -> Agreement:
    """Error of the simulation; the initial state of every record is the one that fits the record best."""
    theta, _, std = problem.unknowns.values(z)
    found = output_error.simulate(replace(problem, records=records), theta, std)
    if found is None:
        return _agreement(problem, records, None, ())
    return _agreement(problem, records, found.found, found.initial_states)


def predicted_agreement(problem: Problem, records: tuple[Record, ...], z: np.ndarray) -> Agreement:
    """Error of the one-step prediction by the Kalman filter of `problem`."""
    found = likelihood.predict(replace(problem, records=records), z)
    if found is None:
        return _agreement(problem, records, None, ())
    return _agreement(problem, records, found.found, found.initial_states)


def _agreement(
    problem: Problem,
    records: tuple[Record, ...],
    found: tuple[Innovations, ...] | None,
    initial_states: tuple[np.ndarray, ...],
) -> Agreement:
    fits: dict[str, float | None] = {}
    rms: dict[str, float | None] = {}
    for j, output in enumerate(problem.family.outputs):
        fits[output.name], rms[output.name] = None, None
        count = sum(int(r.n_observed[j]) for r in records)
        if found is None or count == 0:
            continue
        error = spread = 0.0
        for record, residuals, x0 in zip(records, found, initial_states, strict=True):
            left = residuals.at_zero[:, j] - x0 @ residuals.response[:, :, j]
            measured = record.outputs[record.observed[:, j], j]
            error += float(left @ left)
            spread += float(np.sum((measured - measured.mean()) ** 2)) if measured.size else 0.0
        rms[output.name] = float(np.sqrt(error / count))
        fits[output.name] = float(100.0 * (1.0 - np.sqrt(error / spread))) if spread > 0.0 else None
    return Agreement(fits, rms)


def agreement_of(
    names: Sequence[str], measured: Sequence[np.ndarray], errors: Sequence[np.ndarray] | None
) -> Agreement:
    """Agreement from the errors of all experiments (n_samples, n_y), NaN where missing; None: no errors."""
    fits: dict[str, float | None] = dict.fromkeys(names)
    rms: dict[str, float | None] = dict.fromkeys(names)
    for j, name in enumerate(names if errors is not None else ()):
        assert errors is not None
        left = np.concatenate([e[np.isfinite(e[:, j]), j] for e in errors])
        seen = [m[np.isfinite(m[:, j]), j] for m in measured]
        spread = sum(float(np.sum((m - m.mean()) ** 2)) for m in seen if m.size)
        if left.size:
            rms[name] = float(np.sqrt(np.mean(left**2)))
            fits[name] = float(100.0 * (1.0 - np.sqrt(np.sum(left**2) / spread))) if spread > 0.0 else None
    return Agreement(fits, rms)
