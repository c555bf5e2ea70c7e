"""Prediction errors of nonlinear models: simulated trajectories, or those of an observer with a given gain.

Without a gain this is output error, report (2); with one, every sample corrects the state by gain (y - h),
and the errors are one-step prediction errors (Ljung, System Identification, section 5.7). The covariance of
the errors is the one that maximises the Gaussian likelihood, eliminated exactly; initial states are searched
with the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from daest.estimation.fitting.coordinates import Unknowns
from daest.estimation.fitting.search import Objective
from daest.estimation.fitting.ties import Beginning, with_ties
from daest.estimation.gates import FIT
from daest.estimation.linear.delay_starts import long_past_of, shapes_of_past, steady_past
from daest.estimation.nonlinear.gain_family import GainFamily
from daest.model.experiment import Experiment
from daest.model.holds import Hold
from daest.numerics.tables import turned
from daest.systems.events.integration import Correction, IntegrationError, Trajectory
from daest.systems.reduction.input_slopes import refuse_derivatives
from daest.systems.simulation.integrate import Integrator, Record, integrate_all, interval_inputs, record
from daest.systems.tolerances import SOLVER

LEAST_KEPT, MOST_KEPT = 4, 24  # trajectories: as many as `KEPT_VALUES` allow, the last ones in any case
KEPT_VALUES = 5_000_000  # of their states, outputs and sensitivities, 40 MB


@dataclass(frozen=True)
class TrajectoryProblem:
    """What is fitted to what.

    Experiments are in the model's order of inputs and outputs. Search vector: `unknowns` (parameters only),
    then the initial states of every experiment divided by `state_scale` (n_states,), then the logs of a
    `family` of gains. Without one the `gain` (n_states, n_y) is held; None: no sample corrects the state.
    `given_std` (n_y,): standard deviations that are not estimated, NaN for those that are. Where the problem
    `holds_parameters`, no slopes over those of the integrator are computed.
    """

    model: Integrator
    experiments: tuple[Experiment, ...]
    hold: Hold
    unknowns: Unknowns
    state_scale: np.ndarray
    given_std: np.ndarray
    gain: np.ndarray | None = None
    rtol: float = SOLVER.search_rtol
    atol_of_scale: float = SOLVER.atol_of_scale
    family: GainFamily | None = None
    holds_parameters: bool = False

    @property
    def n_states(self) -> int:
        return self.state_scale.size

    @cached_property
    def output_sizes(self) -> np.ndarray:
        """rms of every measured output (n_y,)."""
        return _sizes(self.experiments)

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """What drives the model in every experiment."""
        explicit = self.model.explicit
        return tuple(record(explicit, e.time, e.inputs, self.hold) for e in self.experiments)

    def theta(self, z: np.ndarray) -> np.ndarray:
        """All parameters of the model at z. Shapes: z (n_z,); parameters (n_theta,)."""
        return self.unknowns.values(z[: len(self.unknowns.coordinates)])[0]

    def initial_states(self, z: np.ndarray) -> np.ndarray:
        """(n_experiments, n_states)."""
        start = len(self.unknowns.coordinates)
        states = z[start : start + len(self.experiments) * self.n_states]
        return states.reshape(len(self.experiments), self.n_states) * self.state_scale

    def logs(self, z: np.ndarray) -> np.ndarray:
        """Of the noise levels, where their `family` is searched."""
        return z[z.size - (0 if self.family is None else self.family.n_logs) :]

    def corrected_by(
        self, z: np.ndarray, with_slopes: bool = False
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The gain at z, and its slopes over the logs. Raises IntegrationError where there is none."""
        if self.family is None:
            return self.gain, None
        logs = self.logs(z)
        found = self.family.at(logs)
        slopes = self.family.slopes(logs, found) if found is not None and with_slopes else None
        if found is None or (with_slopes and slopes is None):
            raise IntegrationError("there is no stationary gain", float(self.experiments[0].time[0]))
        return found.gain, slopes

    @property
    def is_predictor(self) -> bool:
        return self.gain is not None or self.family is not None

    @cached_property
    def held_starts(self) -> np.ndarray:
        """Which initial states (n_experiments, n_states) stay at zero, whatever the data are."""
        names, rhs = self.model.explicit.state_names, self.model.explicit.rhs
        if not np.any(shapes_of_past(names)):
            return np.zeros((len(self.experiments), len(names)), dtype=bool)
        by_state, by_input = (ca.DM(rhs.jac_sparsity(0, i), 1).full() != 0.0 for i in (0, 1))
        return np.array([steady_past(names, by_state, by_input, e.inputs) for e in self.experiments])

    def long_past(self, z: np.ndarray) -> np.ndarray:
        """Which initial states (n_experiments, n_states) are the shape of what a long delay keeps. Shapes: z
        (n_z,)."""
        explicit, theta = self.model.explicit, self.theta(z)
        return np.array([long_past_of(explicit, theta, e) for e in self.experiments])

    def held_at(self, z: np.ndarray) -> TrajectoryProblem:
        """The problem with its parameters held as in z: only initial states are searched. Shapes: z
        (n_z,)."""
        held = replace(self.unknowns, coordinates=(), theta=self.theta(z))
        return replace(self, unknowns=held, holds_parameters=True)

    def predict(self, z: np.ndarray, with_slopes: bool = False) -> Errors | None:
        """Every experiment at z; None where an integration fails. Shapes: z (n_z,)."""
        return prediction_errors(self, z, with_slopes)

    def derivatives(self, found: Errors, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and information along z. Shapes: z (n_z,); gradient (n_z,), information (n_z, n_z)."""
        residuals, slopes = whitened(self, found, z)
        return slopes @ residuals, slopes @ slopes.T

    def tied(self, likelihood: Objective) -> Objective:
        beginnings = [_beginning(self, experiment) for experiment in self.experiments]
        return with_ties(likelihood, self.model.explicit, self.unknowns, self.state_scale, beginnings)


@dataclass(frozen=True)
class Errors:
    """y - ŷ per experiment (n_samples, n_y), NaN where missing; their covariance (n_y, n_y); the
    trajectories."""

    errors: tuple[np.ndarray, ...]
    covariance: np.ndarray
    trajectories: tuple[Trajectory, ...]
    negative_log_likelihood: float


def _beginning(problem: TrajectoryProblem, experiment: Experiment) -> Beginning:
    n_u = experiment.inputs.shape[1]
    head = slice(0, 2)
    ubar, _ = interval_inputs(
        problem.model.explicit, experiment.time[head], experiment.inputs[head], problem.hold
    )
    first = ubar[0] if ubar.size else experiment.inputs[0]
    return Beginning(experiment.inputs[0], first[n_u:], float(experiment.time[0]))


def prediction_errors(problem: TrajectoryProblem, z: np.ndarray, with_slopes: bool = False) -> Errors | None:
    """Run every experiment at z; None where an integration fails (the search then steps back). Shapes: z
    (n_z,)."""
    try:
        trajectories = integrated(problem, z, with_slopes)
    except IntegrationError:
        return None
    errors = tuple(e.outputs - t.outputs for e, t in zip(problem.experiments, trajectories, strict=True))
    with np.errstate(over="ignore", invalid="ignore"):
        covariance = _covariance(problem, errors)
        if _has_run_away(covariance, problem.output_sizes):
            return None
        value = _negative_log_likelihood(errors, covariance)
    return Errors(errors, covariance, tuple(trajectories), value)


def _has_run_away(covariance: np.ndarray, sizes: np.ndarray) -> bool:
    """Whether errors of this covariance (n_y, n_y) are beyond all that outputs of these `sizes` (n_y,) do.
    The units of the outputs do not matter: a pressure is 10⁹ times the position beside it."""
    relative = covariance / np.outer(sizes, sizes)
    return not np.all(np.isfinite(relative)) or bool(np.linalg.cond(relative) > FIT.runaway)


def integrated(problem: TrajectoryProblem, z: np.ndarray, with_slopes: bool = False) -> list[Trajectory]:
    """Trajectories of every experiment at z. Raises IntegrationError. Shapes: z (n_z,)."""
    theta = problem.theta(z)
    refuse_derivatives(problem.model.explicit, problem.hold, theta)
    gain, gain_slopes = problem.corrected_by(z, with_slopes)
    starts, experiments = problem.initial_states(z), problem.experiments
    along = _directions(problem, gain_slopes) if with_slopes else None
    keys = [_key(problem, theta, start, gain) for start in starts]
    known = (_known(problem, e, key, along) for e, key in zip(experiments, keys, strict=True))
    found = {i: one for i, one in enumerate(known) if one is not None}
    missing = [i for i in range(len(experiments)) if i not in found]
    made = integrate_all(
        problem.model,
        [problem.records[i] for i in missing],
        theta,
        starts[missing],
        [None if gain is None else Correction(experiments[i].outputs, gain, gain_slopes) for i in missing],
        sensitivities=with_slopes,
        by_parameter=not problem.holds_parameters,
        rtol=problem.rtol,
        atol_of_scale=problem.atol_of_scale,
        state_scale=problem.state_scale,
    )
    found |= dict(zip(missing, made, strict=True))
    _keep([_Kept(_engine(problem), experiments[i], keys[i], along, found[i]) for i in missing])
    return [found[i] for i in range(len(experiments))]


@dataclass(frozen=True)
class _Kept:
    """A trajectory, its sensitivities those of the directions `along`, None for none: the point at which a
    search ends is asked for again by what judges it, and the next search begins there."""

    engine: Any
    experiment: Experiment
    key: tuple
    along: tuple | None
    trajectory: Trajectory

    @property
    def n_values(self) -> int:
        made = self.trajectory
        return made.states.size + made.outputs.size + made.sensitivities.size


_kept: list[_Kept] = []


def _keep(made: Sequence[_Kept]) -> None:
    """Keep what was made last, with its sensitivities where there is room for them; of what was made before,
    as much as there is room for without."""
    is_small = sum(one.n_values for one in made) <= KEPT_VALUES
    before = [_without_slopes(one) for one in _kept] if made else _kept
    several = [*before, *(made if is_small else map(_without_slopes, made))][-MOST_KEPT:]
    while len(several) > LEAST_KEPT and sum(one.n_values for one in several) > KEPT_VALUES:
        del several[0]
    _kept[:] = several


def _engine(problem: TrajectoryProblem) -> Any:
    """What integrates: the compiled code, which several integrators may share, or the integrator itself."""
    return getattr(problem.model, "library", None) or problem.model


def _key(problem: TrajectoryProblem, theta: np.ndarray, x0: np.ndarray, gain: np.ndarray | None) -> tuple:
    arrays = (theta, x0, problem.state_scale)
    given = None if gain is None else gain.tobytes()
    return problem.hold, problem.rtol, problem.atol_of_scale, given, *(a.tobytes() for a in arrays)


def _directions(problem: TrajectoryProblem, gain_slopes: np.ndarray | None) -> tuple:
    """What tells the directions of sensitivities from others."""
    names = () if problem.holds_parameters else problem.model.names
    return names, problem.holds_parameters, None if gain_slopes is None else gain_slopes.tobytes()


def _known(
    problem: TrajectoryProblem, experiment: Experiment, key: tuple, along: tuple | None
) -> Trajectory | None:
    """The same run, if it is one of the last ones, with the sensitivities `along` directions, if any."""
    engine = _engine(problem)
    for one in tuple(_kept):
        is_same = one.key == key and one.engine is engine and one.experiment is experiment
        if is_same and along in (None, one.along):
            return (_without_slopes(one) if along is None else one).trajectory
    return None


def _without_slopes(one: _Kept) -> _Kept:
    if one.along is None:
        return one
    made = one.trajectory
    bare = replace(made, sensitivities=made.sensitivities[:, :, :0].copy())
    return replace(one, along=None, trajectory=bare)


def _covariance(problem: TrajectoryProblem, errors: tuple[np.ndarray, ...]) -> np.ndarray:
    """Full for an observer with complete data; else diagonal, as output error assumes."""
    table = np.concatenate(errors)
    floor = FIT.smallest_std * problem.output_sizes
    observed = np.isfinite(table)
    squares = np.where(observed, table, 0.0) ** 2
    found = np.sqrt(squares.sum(axis=0) / np.maximum(observed.sum(axis=0), 1))
    given = problem.given_std
    std = np.where(np.isfinite(given), given, np.maximum(found, floor))
    if not problem.is_predictor or not np.all(observed) or np.any(np.isfinite(given)):
        return np.diag(std**2)
    return table.T @ table / table.shape[0] + np.diag(floor**2)


def _sizes(experiments: tuple[Experiment, ...]) -> np.ndarray:
    """rms of every measured output over all experiments, 1 for an output of zeros."""
    table = np.concatenate([e.outputs for e in experiments])
    squares = np.where(np.isfinite(table), table, 0.0) ** 2
    size = np.sqrt(squares.sum(axis=0) / np.maximum(np.isfinite(table).sum(axis=0), 1))
    return np.where(size > 0.0, size, 1.0)


def _negative_log_likelihood(errors: tuple[np.ndarray, ...], covariance: np.ndarray) -> float:
    table = np.concatenate(errors)
    observed = np.isfinite(table)
    if np.all(observed):
        root = np.linalg.cholesky(covariance)
        white = np.linalg.solve(root, table.T)
        log_det = 2 * table.shape[0] * np.sum(np.log(np.diagonal(root)))
        return float((np.sum(white**2) + log_det + table.size * np.log(2 * np.pi)) / 2)
    variance = np.diagonal(covariance)
    squares = np.where(observed, table, 0.0) ** 2 / variance
    return float((squares.sum() + np.sum(observed * np.log(2 * np.pi * variance))) / 2)


def whitened(problem: TrajectoryProblem, errors: Errors, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whitened errors (m,) and their slopes (p, m) over the search vector, missing samples as zeros."""
    root = turned(np.linalg.inv(np.linalg.cholesky(errors.covariance)))
    n_parameters, n_states = len(problem.unknowns.coordinates), problem.n_states
    n_logs = 0 if problem.family is None else problem.family.n_logs
    per_z = [problem.unknowns.slopes(z[:n_parameters]), problem.state_scale, np.ones(n_logs)]
    scale = -np.concatenate(per_z)[:, None, None]
    residuals, slopes = [], []
    for number, (error, trajectory) in enumerate(zip(errors.errors, errors.trajectories, strict=True)):
        observed = np.isfinite(error)
        is_whole = bool(np.all(observed))
        # (n_samples, n_y, directions) -> (directions, n_samples, n_y)
        change = np.ascontiguousarray(trajectory.sensitivities.transpose(2, 0, 1)) * scale
        change = _times(change if is_whole else np.where(observed, change, 0.0), root)
        own = np.zeros((z.size, error.size))
        first = n_parameters + number * n_states
        rows = [*range(n_parameters), *range(first, first + n_states), *range(z.size - n_logs, z.size)]
        own[rows] = change.reshape(len(rows), error.size)
        residuals.append(_times(error if is_whole else np.where(observed, error, 0.0), root).ravel())
        slopes.append(own)
    return np.concatenate(residuals), np.concatenate(slopes, axis=1)


def _times(table: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """table @ matrix (n_y, n_y), in a tenth of the time where there is one output."""
    return table * matrix[0, 0] if matrix.size == 1 else table @ matrix
