"""Output error by multiple shooting, for simulations that a poor start makes meaningless.

The record is cut into segments with initial states of their own, which are tied by continuity
(Bock, in Modelling of Chemical Reaction Systems, Springer 1981). Segments stay near the data at any
parameters, so that a wrong parameter shows as gaps between them instead of a trajectory that has left.
Each step is that of a Fisher scoring over parameters and all initial states which closes the linearised gaps,
as long as the likelihood and the gaps together become better (sequential quadratic programming, Nocedal &
Wright, Numerical Optimization, 2006, sections 15.4 to 15.6 and 18.1). Gradients are exact: the states at the
end of a segment are outputs of the compiled integrator, with their sensitivities.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal

import casadi as ca
import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from daest.estimation.fitting.coordinates import objective, with_priors
from daest.estimation.fitting.identifiability import Scores, scores
from daest.estimation.fitting.records import part_of
from daest.estimation.fitting.search import Evaluation, Found, free_coordinates, minimise
from daest.estimation.gates import FIT
from daest.estimation.nonlinear.trajectories import Errors, TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.flat import Dynamics
from daest.numerics import deadline
from daest.numerics.bordered import bordered
from daest.systems.simulation.integrate import integrator

MOST_STEPS = 60
STEPS_PER_ITERATION = 4  # of the iterations that a search without cuts is allowed
FIRST_DAMPING, MOST_DAMPING = 1e-3, 1e6  # relative to the information
LONG, SHORT, SHORTEST = 0.3, 1 / 3, 1e-3  # parts of a step: long enough, from one trial to the next, no step
PRICE = 1.5  # of a gap, in the largest force that holds one closed
DECREASE = 1e-4  # of what the linearised problem promises, that a step must bring
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
    Raises OutOfTimeError. Shapes: z (n_z,)."""
    shooting = shooting_of(problem, n_segments)
    p = len(problem.unknowns.coordinates)
    shooting, states = _states_near_data(shooting, z[:p], problem.initial_states(z))
    tied, limits = _Tied(shooting), _limits(shooting)
    begun = np.concatenate([z[:p], (states / shooting.problem.state_scale).ravel()])
    here = tied.at(np.clip(begun, *limits))
    if here is None:
        return None
    damping, end, n_steps = FIRST_DAMPING, None, 0
    while end is None and n_steps < min(MOST_STEPS, STEPS_PER_ITERATION * max_iterations):
        found = _stepped(tied, here, damping, limits)
        end = _end(here, found)
        if found is not None and end is None:
            damping = found.damping / 10.0 if found.part > LONG else 3.0 * found.damping
            here, n_steps = found.point, n_steps + 1
    found_at = Found(here.z, here.evaluation, end or "iteration limit", n_steps, 0.0)
    return Cut(shooting, found_at, here.largest_gap <= FIT.nearly_continuous)


@dataclass(frozen=True)
class _Point:
    """Where a search is: the objective without ties, with slopes where they were wanted; the gaps (n_gaps,)
    in units of the state scales and, with slopes, ∂gaps/∂z (n_gaps, n_z)."""

    z: np.ndarray
    evaluation: Evaluation
    gaps: np.ndarray
    ties: np.ndarray

    @property
    def largest_gap(self) -> float:
        return float(np.max(np.abs(self.gaps), initial=0.0))

    @property
    def is_continuous(self) -> bool:
        return self.largest_gap < FIT.continuous

    def merit(self, price: float) -> float:
        """The objective and what the gaps cost, but for those that count as none."""
        open_ = np.maximum(np.abs(self.gaps) - FIT.continuous, 0.0)
        return self.evaluation.value + price * float(np.sum(open_))


class _Tied:
    """Negative log-likelihood and priors over parameters and all states, with the gaps between segments."""

    def __init__(self, shooting: Shooting) -> None:
        self.shooting = shooting
        self._errors: Errors | None = None
        self._objective = with_priors(self._likelihood, shooting.problem.unknowns)

    def at(self, z: np.ndarray, with_slopes: bool = True) -> _Point | None:
        """None where a segment cannot be simulated. Shapes: z (n_z,)."""
        evaluation = self._objective(z, with_slopes)
        if evaluation is None or self._errors is None:
            return None
        gaps = _gaps_of(self.shooting, self._errors, z).ravel()
        ties = _ties(self.shooting, self._errors, z) if with_slopes else np.zeros((0, z.size))
        parts = (np.array(evaluation.value), evaluation.gradient, evaluation.information, gaps, ties)
        return _Point(z, evaluation, gaps, ties) if all(np.all(np.isfinite(part)) for part in parts) else None

    def _likelihood(self, z: np.ndarray, with_slopes: bool) -> Evaluation | None:
        self._errors = errors = prediction_errors(self.shooting.problem, z, with_slopes)
        if errors is None:
            return None
        slopes = _data_part(self.shooting, errors, z) if with_slopes else ()
        return Evaluation(errors.negative_log_likelihood, *slopes)


@dataclass(frozen=True)
class _Step:
    """What a step has led to: a `part` of the one that the `damping` gives, which promised a `gain` in
    log-likelihood."""

    point: _Point
    part: float
    damping: float
    gain: float


def _end(here: _Point, found: _Step | None) -> Literal["converged", "stalled"] | None:
    """How the search ends at a point from which a step was looked for; None where it goes on."""
    if found is None:
        return "stalled"
    return "converged" if here.is_continuous and found.gain < FIT.converged_gain else None


def _stepped(
    tied: _Tied, here: _Point, damping: float, limits: tuple[np.ndarray, np.ndarray]
) -> _Step | None:
    """The next point; None where no damping gives a better one."""
    closing = _Closing(here, len(tied.shooting.problem.unknowns.coordinates), limits)
    promised = np.inf
    while damping <= MOST_DAMPING:
        deadline.check()
        with suppress(np.linalg.LinAlgError):
            closing.solve(damping)
            gain = abs(float(here.evaluation.gradient @ closing.step))
            promised = gain if promised == np.inf else promised
            if here.is_continuous and gain < FIT.converged_gain:
                return _Step(here, 1.0, damping, gain)
            found = _along(tied, here, closing, limits)
            if found is not None:
                point, part = found
                return _Step(point, part, damping, gain if here.is_continuous else np.inf)
        damping = max(10.0 * damping, FIRST_DAMPING)
    # What little there is to gain may drown in the rounding of the gaps.
    is_near = here.is_continuous and promised < FIT.stalled_gain
    return _Step(here, 1.0, damping, 0.0) if is_near else None


def _along(
    tied: _Tied, here: _Point, closing: _Closing, limits: tuple[np.ndarray, np.ndarray]
) -> tuple[_Point, float] | None:
    """The first part of a step that is better, and how large it is; where the whole one opens gaps by how the
    segments bend, with these closed once more; None where no part is."""
    price = closing.price
    promised = min(float(here.evaluation.gradient @ closing.step) - price * np.sum(np.abs(here.gaps)), 0.0)
    part = closing.longest
    while part > SHORTEST:
        most = here.merit(price) + DECREASE * part * promised
        there = tied.at(np.clip(here.z + part * closing.step, *limits), with_slopes=False)
        if there is not None and part == 1.0 and not there.merit(price) < most:
            there = tied.at(np.clip(there.z + closing.back(there.gaps), *limits), with_slopes=False)
        if there is not None and there.merit(price) < most:
            better = tied.at(there.z)
            if better is not None:
                return better, part
        part *= SHORT
    return None


class _Closing:
    """The step from a point that is best for the likelihood among those that close the linearised gaps, of
    free coordinates, for a damping. Raises LinAlgError where there is none.

    H d + g + Gᵀ ν = 0 with G d = -c, gaps c and ties G, is solved with H + w Gᵀ G in place of H, which is
    definite and of the same structure, by the Schur complement of the ties (Nocedal & Wright, section 16.2);
    ν are the forces that hold the gaps closed."""

    def __init__(self, here: _Point, n_parameters: int, limits: tuple[np.ndarray, np.ndarray]) -> None:
        information, gradient = here.evaluation.information, here.evaluation.gradient
        by_states = np.diagonal(information)[n_parameters:]
        weight = max(float(np.median(by_states)) if by_states.size else 1.0, 1.0)
        ties = csr_array(here.ties)  # of neighbours alone
        tied = information + weight * (ties.T @ ties).toarray()
        self.free = free_coordinates(here.z, replace(here.evaluation, information=tied), *limits)
        self.scale = np.sqrt(np.diagonal(tied)[self.free])
        self.information = bordered(tied[np.ix_(self.free, self.free)] / np.outer(self.scale, self.scale))
        self.ties = csr_array(here.ties[:, self.free] / self.scale)
        self.pull = (gradient + weight * here.ties.T @ here.gaps)[self.free] / self.scale
        self.gaps, self.n_parameters = here.gaps, n_parameters
        self.step = np.zeros(here.z.size)
        self.price = 0.0

    def solve(self, damping: float) -> None:
        """Finds the step for a damping."""
        solve = self.information.factor(damping + FIT.flat)
        self._by_ties = solve(self.ties.T.toarray())
        schur = self.ties @ self._by_ties
        self._schur = (
            cho_factor(schur + FIT.flat * np.trace(schur) * np.eye(len(schur))) if len(schur) else None
        )
        moved = solve(self.pull)
        forces = self._forces(self.gaps - self.ties @ moved)
        self.step = self._spread(-(moved + self._by_ties @ forces))
        self.price = PRICE * float(np.max(np.abs(forces), initial=0.0))

    @property
    def longest(self) -> float:
        """The part of the step in which no parameter moves by more than FIT.largest_step."""
        moved = float(np.max(np.abs(self.step[: self.n_parameters]), initial=0.0))
        return min(1.0, FIT.largest_step / max(moved, FIT.largest_step))

    def back(self, gaps: np.ndarray) -> np.ndarray:
        """The least step that closes the linearised gaps. Shapes: gaps (n_gaps,); step (n_z,)."""
        return self._spread(-self._by_ties @ self._forces(gaps))

    def _forces(self, gaps: np.ndarray) -> np.ndarray:
        return gaps if self._schur is None else cho_solve(self._schur, gaps)

    def _spread(self, step: np.ndarray) -> np.ndarray:
        whole = np.zeros(self.free.size)
        whole[self.free] = step / self.scale
        return whole


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


def _gaps_of(shooting: Shooting, errors: Errors, z: np.ndarray) -> np.ndarray:
    scale = shooting.problem.state_scale
    starts = shooting.problem.initial_states(z)
    gaps = [errors.trajectories[i].states[-1] - starts[j] for i, j in shooting.pairs]
    return np.array(gaps).reshape(-1, scale.size) / scale


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


def _ties(shooting: Shooting, errors: Errors, z: np.ndarray) -> np.ndarray:
    """∂gaps/∂z (n_pairs n, n_z)."""
    n = shooting.problem.n_states
    units, scale = _units(shooting, z), shooting.problem.state_scale
    ties = np.zeros((len(shooting.pairs) * n, z.size))
    for number, (i, j) in enumerate(shooting.pairs):
        end = errors.trajectories[i].sensitivities[-1, shooting.n_outputs :] * units / scale[:, None]
        ties[number * n : (number + 1) * n, _rows(shooting, i, j)] = np.hstack([end, -np.eye(n)])
    return ties


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
