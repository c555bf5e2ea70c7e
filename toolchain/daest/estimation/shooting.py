"""Output error by multiple shooting, for simulations that a poor start makes meaningless.

The record is cut into segments with initial states of their own, which are tied by continuity
(Bock, in Modelling of Chemical Reaction Systems, Springer 1981). Segments stay near the data at any
parameters, so that a wrong parameter shows as gaps between them instead of a trajectory that has left.
Continuity is reached by an augmented Lagrangian, whose weight grows from loose to tight; each of its problems
is a bounded Fisher scoring over parameters and all initial states. Gradients are exact: the states at the end
of a segment are outputs of the compiled integrator, with their sensitivities.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from daest.estimation.coordinates import objective, with_priors
from daest.estimation.gates import FIT
from daest.estimation.identifiability import Scores, scores
from daest.estimation.records import part_of
from daest.estimation.search import Evaluation, Found, Objective, minimise
from daest.estimation.trajectories import Errors, TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.flat import Dynamics
from daest.systems.integrate import integrator

FIRST_WEIGHT = 10.0  # of squared gaps in units of the state scales: loose
WEIGHT_GROWTH = 10.0
ROUNDS = 14
ITERATIONS = 15  # of each round but the last
STATE_ITERATIONS = 15  # of the fits of segments to the data, parameters held
MOST_SEGMENTS = 20  # unless told otherwise
FEWEST_SAMPLES = 10  # of a segment


@dataclass(frozen=True)
class Shooting:
    """A record cut into segments. `problem` has every segment as an experiment and the states as further
    outputs without measurements; `groups` holds the numbers of the segments of each record."""

    problem: TrajectoryProblem
    groups: tuple[tuple[int, ...], ...]
    n_outputs: int

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Segments that follow each other."""
        return [pair for group in self.groups for pair in pairwise(group)]


@dataclass(frozen=True)
class Cut:
    """The end of a search by multiple shooting: `found` over parameters and states of all segments."""

    shooting: Shooting
    found: Found
    is_continuous: bool


def default_segments(experiments: tuple[Experiment, ...]) -> int:
    """Segments that a record is cut into where no number is asked for."""
    shortest = min(e.n_samples for e in experiments)
    return max(1, min(MOST_SEGMENTS, shortest // FEWEST_SAMPLES))


def shooting_of(problem: TrajectoryProblem, n_segments: int) -> Shooting:
    """`problem` (without a gain) with every experiment cut into `n_segments` of equal length, fewer where a
    segment would be empty."""
    explicit = problem.model.explicit
    n_y, n = len(explicit.flat.outputs), explicit.n_states
    segments: list[Experiment] = []
    groups = []
    for experiment in problem.experiments:
        first = len(segments)
        cuts = np.unique(np.linspace(0, experiment.n_samples - 1, n_segments + 1).astype(int))
        ends = list(pairwise(cuts))
        segments += [_segment(experiment, a, b, b == cuts[-1], explicit.state_names) for a, b in ends]
        groups.append(tuple(range(first, len(segments))))
    sizes = np.concatenate([e.outputs for e in problem.experiments])
    small = FIT.unmeasured_noise * np.exp(np.mean(np.log(np.nanstd(sizes, axis=0) + np.finfo(float).tiny)))
    cut = replace(
        problem,
        model=integrator(_with_states(explicit), problem.model.names, compiled=problem.model.is_compiled),
        experiments=tuple(segments),
        given_std=np.concatenate([problem.given_std, np.full(n, small)]),
    )
    return Shooting(cut, tuple(groups), n_y)


def _segment(
    experiment: Experiment, first: int, last: int, is_end: bool, states: tuple[str, ...]
) -> Experiment:
    """Samples first..last; the last one is measured in the next segment."""
    rows = slice(first, last + 1)
    y = experiment.outputs[rows].copy()
    if not is_end:
        y[-1] = np.nan
    return replace(
        experiment,
        time=experiment.time[rows],
        inputs=experiment.inputs[rows],
        outputs=np.hstack([y, np.full((y.shape[0], len(states)), np.nan)]),
        output_names=(*experiment.output_names, *(f"state {name}" for name in states)),
        extra={},
    )


def _with_states(explicit: Dynamics) -> Dynamics:
    kind: Any = ca.SX if explicit.is_symbolic else ca.MX
    arguments = [kind.sym(f"a{i}", explicit.outputs.numel_in(i)) for i in range(6)]
    y = explicit.outputs(*arguments)
    return replace(explicit, outputs=ca.Function("outputs", arguments, [ca.vertcat(y, arguments[0])]))


def search_by_shooting(
    problem: TrajectoryProblem, z: np.ndarray, n_segments: int, max_iterations: int
) -> Cut | None:
    """The end of the search; None where no segment can be simulated. z is the search vector of `problem`.
    Shapes: z (n_z,)."""
    shooting = shooting_of(problem, n_segments)
    p = len(problem.unknowns.coordinates)
    shooting, states = _states_near_data(shooting, z[:p], problem.initial_states(z))
    z = np.concatenate([z[:p], (states / shooting.problem.state_scale).ravel()])
    lower, upper = _limits(shooting)
    multipliers = np.zeros((len(shooting.pairs), problem.n_states))
    weight = FIRST_WEIGHT
    found: Found | None = None
    for number in range(ROUNDS):
        tied = _tied(shooting, multipliers, weight)
        iterations = max_iterations if number == ROUNDS - 1 else min(ITERATIONS, max_iterations)
        found = minimise(tied, z, lower, upper, iterations)
        if found is None:
            return None
        z = found.z
        gaps = _gaps(shooting, z)
        if gaps is None:
            return None
        if np.max(np.abs(gaps), initial=0.0) < FIT.continuous and found.reason == "converged":
            break
        multipliers = multipliers + weight * gaps
        weight *= WEIGHT_GROWTH
    assert found is not None
    gaps = _gaps(shooting, z)
    closed = gaps is not None and np.max(np.abs(gaps), initial=0.0) <= FIT.nearly_continuous
    plain = _tied(shooting, multipliers, 0.0 * weight)(z, True)
    return None if plain is None else Cut(shooting, replace(found, evaluation=plain), closed)


def start_of(shooting: Shooting, z: np.ndarray) -> np.ndarray:
    """The search vector of the uncut problem: parameters and the states at the start of every record. Shapes:
    z (p + n_pieces n_states,); result (p + n_records n_states,)."""
    p = len(shooting.problem.unknowns.coordinates)
    states = z[p:].reshape(-1, shooting.problem.n_states)
    return np.concatenate([z[:p], *(states[group[0]] for group in shooting.groups)])


def _limits(shooting: Shooting) -> tuple[np.ndarray, np.ndarray]:
    problem = shooting.problem
    n_states = len(problem.experiments) * problem.n_states
    lower = np.concatenate([problem.unknowns.lower, np.full(n_states, -FIT.state_range)])
    upper = np.concatenate([problem.unknowns.upper, np.full(n_states, FIT.state_range)])
    return lower, upper


def _states_near_data(
    shooting: Shooting, parameters: np.ndarray, first: np.ndarray
) -> tuple[Shooting, np.ndarray]:
    """Initial states (n_segments, n) in their units that fit the segments one after the other, parameters
    held; and the problem with state scales read off them. A segment starts from the end of the one before."""
    problem = shooting.problem
    states = np.zeros((len(problem.experiments), problem.n_states))
    largest = np.zeros(problem.n_states)
    for group, x0 in zip(shooting.groups, first, strict=True):
        x = x0
        for number in group:
            alone = replace(problem, experiments=(problem.experiments[number],))
            x, path = _fitted_state(alone, parameters, x)
            states[number] = x
            if path is not None:
                largest = np.maximum(largest, np.max(np.abs(path), axis=0))
                x = path[-1]
    scale = np.where(largest > 0.0, largest, 1.0)
    return replace(shooting, problem=replace(problem, state_scale=scale)), states


def _fitted_state(
    alone: TrajectoryProblem, parameters: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """The initial state of one segment that fits it, and the states along it."""
    z = np.concatenate([parameters, x / alone.state_scale])
    p = parameters.size
    lower, upper = z - FIT.state_range, z + FIT.state_range
    lower[:p] = upper[:p] = parameters
    found = minimise(objective(alone), z, lower, upper, STATE_ITERATIONS)
    if found is None:
        short = replace(alone, experiments=(part_of(alone.experiments[0], 0, FEWEST_SAMPLES),))
        found = minimise(objective(short), z, lower, upper, STATE_ITERATIONS)
    if found is None:
        return x, None
    x = found.z[p:] * alone.state_scale
    errors = prediction_errors(alone, found.z)
    return x, None if errors is None else errors.trajectories[0].states


def _gaps(shooting: Shooting, z: np.ndarray) -> np.ndarray | None:
    """End of each segment less the start of the next (n_pairs, n), in units of the state scales."""
    errors = prediction_errors(shooting.problem, z)
    return None if errors is None else _gaps_of(shooting, errors, z)


def _gaps_of(shooting: Shooting, errors: Errors, z: np.ndarray) -> np.ndarray:
    scale = shooting.problem.state_scale
    starts = shooting.problem.initial_states(z)
    gaps = [errors.trajectories[i].states[-1] - starts[j] for i, j in shooting.pairs]
    return np.array(gaps).reshape(-1, scale.size) / scale


def _tied(shooting: Shooting, multipliers: np.ndarray, weight: float) -> Objective:
    """Negative log-likelihood and priors + Σ λᵀ gap + weight Σ |gap|² / 2 over parameters and all states."""
    problem = shooting.problem

    def evaluate(z: np.ndarray, with_slopes: bool) -> Evaluation | None:
        errors = prediction_errors(problem, z, with_slopes)
        if errors is None:
            return None
        gaps = _gaps_of(shooting, errors, z)
        value = errors.negative_log_likelihood + np.sum(multipliers * gaps) + weight * np.sum(gaps**2) / 2
        if not np.isfinite(value):
            return None
        if not with_slopes:
            return Evaluation(float(value))
        gradient, information = _data_part(shooting, errors, z)
        force = multipliers + weight * gaps
        for number, (rows, slope) in enumerate(_gap_slopes(shooting, errors, z)):
            gradient[rows] += slope.T @ force[number]
            information[np.ix_(rows, rows)] += weight * slope.T @ slope
        if not (np.all(np.isfinite(gradient)) and np.all(np.isfinite(information))):
            return None
        return Evaluation(float(value), gradient, information)

    return with_priors(evaluate, problem.unknowns)


def _rows(shooting: Shooting, *segments: int) -> np.ndarray:
    """Places in z of the parameters and of the states of the segments."""
    p, n = len(shooting.problem.unknowns.coordinates), shooting.problem.n_states
    return np.concatenate([np.arange(p), *(p + i * n + np.arange(n) for i in segments)])


def _units(shooting: Shooting, z: np.ndarray) -> np.ndarray:
    """∂(parameters, one initial state)/∂z."""
    p = len(shooting.problem.unknowns.coordinates)
    return np.concatenate([shooting.problem.unknowns.slopes(z[:p]), shooting.problem.state_scale])


def _data_part(shooting: Shooting, errors: Errors, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    gradient, information = np.zeros(z.size), np.zeros((z.size, z.size))
    n_y, units = shooting.n_outputs, _units(shooting, z)
    std = np.sqrt(np.diagonal(errors.covariance))[:n_y]
    for number, (error, path) in enumerate(zip(errors.errors, errors.trajectories, strict=True)):
        seen = np.isfinite(error[:, :n_y])
        white = (np.where(seen, error[:, :n_y], 0.0) / std).ravel()
        slopes = (np.where(seen, 1.0 / std, 0.0)[:, :, None] * -path.sensitivities[:, :n_y] * units).reshape(
            white.size, -1
        )
        rows = _rows(shooting, number)
        gradient[rows] += slopes.T @ white
        information[np.ix_(rows, rows)] += slopes.T @ slopes
    return gradient, information


def _gap_slopes(shooting: Shooting, errors: Errors, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Per gap: places in z, and ∂gap/∂z there (n, p + 2 n)."""
    n = shooting.problem.n_states
    units, scale = _units(shooting, z), shooting.problem.state_scale
    result = []
    for i, j in shooting.pairs:
        end = errors.trajectories[i].sensitivities[-1, shooting.n_outputs :] * units / scale[:, None]
        result.append((_rows(shooting, i, j), np.hstack([end, -np.eye(n)])))
    return result


def whole_errors(cut: Cut, with_slopes: bool = False) -> tuple[Errors, list[Scores]]:
    """The errors of the records, joined from those of their segments (trajectories are left cut), and with
    slopes their scores under continuity."""
    errors = prediction_errors(cut.shooting.problem, cut.found.z, with_slopes)
    assert errors is not None
    parts = _whole_scores(cut.shooting, errors) if with_slopes else []
    return _joined(cut.shooting, errors), parts


def _joined(shooting: Shooting, errors: Errors) -> Errors:
    n_y = shooting.n_outputs
    joined = []
    for group in shooting.groups:
        parts = [errors.errors[i][:-1, :n_y] for i in group[:-1]] + [errors.errors[group[-1]][:, :n_y]]
        joined.append(np.vstack(parts))
    return Errors(
        tuple(joined), errors.covariance[:n_y, :n_y], errors.trajectories, errors.negative_log_likelihood
    )


def _whole_scores(shooting: Shooting, errors: Errors) -> list[Scores]:
    """Scores of every record with slopes per unit of the parameters, under continuity.

    Continuity leaves n directions of all states of a record: the null space of its linearised constraints,
    found by orthogonal transformations, so that it stays accurate where a simulation over the whole record
    would overflow. What they explain is projected out.
    """
    p, n, scale = (
        len(shooting.problem.unknowns.coordinates),
        shooting.problem.n_states,
        shooting.problem.state_scale,
    )
    n_y = shooting.n_outputs
    std = np.sqrt(np.diagonal(errors.covariance))[:n_y]
    result = []
    for group in shooting.groups:
        by_parameters, free = _continuous_directions(shooting, errors, group)
        residuals, slopes, responses = [], [], []
        for place, i in enumerate(group):
            rows = slice(None) if i == group[-1] else slice(None, -1)
            error, sens = errors.errors[i][rows, :n_y], errors.trajectories[i].sensitivities[rows, :n_y]
            seen = np.isfinite(error)
            weighted = np.where(seen, 1.0 / std, 0.0)[:, :, None] * sens
            at = slice(place * n, (place + 1) * n)
            own = weighted[:, :, p:] * scale
            residuals.append(np.where(seen, error, 0.0) / std)
            slopes.append(-(weighted[:, :, :p] + own @ by_parameters[at]))
            responses.append(own @ free[at])
        part = scores(
            np.vstack(residuals),
            np.vstack(responses).transpose(2, 0, 1),
            np.vstack(slopes).transpose(2, 0, 1),
        )
        first = scale[:, None] * free[:n]
        cov = first @ part.initial_cov @ first.T
        slope = scale[:, None] * by_parameters[:n] + first @ part.initial_slope
        result.append(Scores(part.residuals, part.slopes, cov, slope))
    return result


def _continuous_directions(
    shooting: Shooting, errors: Errors, group: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """All states of a record, in their scales, that keep it continuous: the least change per unit of each
    parameter (N n, p), and an orthonormal basis of the changes without one (N n, n)."""
    p, n, scale = (
        len(shooting.problem.unknowns.coordinates),
        shooting.problem.n_states,
        shooting.problem.state_scale,
    )
    count = len(group)
    ties, drive = np.zeros(((count - 1) * n, count * n)), np.zeros(((count - 1) * n, p))
    for place, i in enumerate(group[:-1]):
        end = errors.trajectories[i].sensitivities[-1, shooting.n_outputs :] / scale[:, None]
        at = slice(place * n, (place + 1) * n)
        ties[at, at] = end[:, p:] * scale
        ties[at, (place + 1) * n : (place + 2) * n] = -np.eye(n)
        drive[at] = end[:, :p]
    basis, triangle = np.linalg.qr(ties.T, mode="complete")
    m = ties.shape[0]
    inside = np.linalg.solve(triangle[:m].T, -drive) if m else np.zeros((0, p))
    return basis[:, :m] @ inside, basis[:, m:]
