"""A nonlinear model on recordings: simulation from the initial states that fit best, parameters held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from daest.estimation import trajectories
from daest.estimation.coordinates import Unknowns
from daest.estimation.search import minimise
from daest.estimation.trajectories import TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.fit import Agreement
from daest.model.flat import FlatModel
from daest.systems.initialize import initial_point
from daest.systems.integrate import integrator
from daest.systems.reduce import reduce_index

FIRST_SAMPLES = 50  # fitted first, so that a wrong start does not lead the whole simulation astray
ITERATIONS = 15  # of the search for initial states
STATE_RANGE = 1e3  # initial states are searched within this many times their size in a first simulation


@dataclass(frozen=True)
class SimulatedTrial:
    """Model outputs per recording (n_samples, n_y), NaN where the model cannot be integrated; how well they
    agree."""

    outputs: tuple[np.ndarray, ...]
    agreement: Agreement


def simulated_trial(
    flat: FlatModel, experiments: Sequence[Experiment], hold: Literal["zoh", "foh"]
) -> SimulatedTrial:
    """Simulate `flat` with its parameter values on every recording; initial states are found for each."""
    explicit = reduce_index(flat)
    std = np.array([np.nan if output.noise_std is None else output.noise_std for output in flat.outputs])
    unknowns = Unknowns((), flat.theta_values, np.zeros(0), np.zeros(0))
    problem = TrajectoryProblem(
        integrator(explicit), tuple(experiments), hold, unknowns, np.ones(explicit.n_states), std
    )
    starts = np.array([initial_point(explicit, flat.theta_values, e.inputs[0])[0] for e in experiments])
    problem = replace(problem, state_scale=_sizes(problem, starts))
    z = (starts / problem.state_scale).ravel()
    z = _searched(replace(problem, experiments=tuple(map(_head, experiments))), z)
    errors = prediction_errors(problem, _searched(problem, z))
    outputs = (
        tuple(np.full(e.outputs.shape, np.nan) for e in experiments)
        if errors is None
        else tuple(trajectory.outputs for trajectory in errors.trajectories)
    )
    return SimulatedTrial(outputs, agreement(flat, experiments, outputs))


def agreement(flat: FlatModel, experiments: Sequence[Experiment], outputs: Sequence[np.ndarray]) -> Agreement:
    """100 (1 - |y - ŷ| / |y - mean y|) and rms per output; the mean is that of each recording."""
    fits: dict[str, float | None] = {}
    rms: dict[str, float | None] = {}
    for j, output in enumerate(flat.outputs):
        error = spread = 0.0
        count = 0
        for experiment, simulated in zip(experiments, outputs, strict=True):
            y = experiment.outputs[:, j]
            seen = np.isfinite(y)
            error += float(np.sum((y - simulated[:, j])[seen] ** 2))
            spread += float(np.sum((y[seen] - y[seen].mean()) ** 2)) if seen.any() else 0.0
            count += int(seen.sum())
        known = count > 0 and np.isfinite(error)
        rms[output.name] = float(np.sqrt(error / count)) if known else None
        fits[output.name] = 100.0 * (1.0 - float(np.sqrt(error / spread))) if known and spread > 0 else None
    return Agreement(fits, rms)


def _sizes(problem: TrajectoryProblem, starts: np.ndarray) -> np.ndarray:
    """Largest absolute value of every state in a first simulation, 1 where there is none."""
    errors = prediction_errors(problem, starts.ravel())
    if errors is None:
        return np.ones(problem.n_states)
    size = np.max([np.max(np.abs(t.states), axis=0) for t in errors.trajectories], axis=0)
    return np.where(np.isfinite(size) & (size > 0.0), size, 1.0)


def _searched(problem: TrajectoryProblem, z: np.ndarray) -> np.ndarray:
    limit = np.full(z.size, STATE_RANGE)
    found = minimise(trajectories.objective(problem), z, -limit, limit, ITERATIONS)
    return z if found is None else found.z


def _head(experiment: Experiment) -> Experiment:
    rows = slice(0, FIRST_SAMPLES)
    return replace(
        experiment,
        time=experiment.time[rows],
        inputs=experiment.inputs[rows],
        outputs=experiment.outputs[rows],
        extra={},
    )
