"""Predictors of linear models: the simulation, and the one-step predictions of the Kalman filter, with exact
derivatives by sensitivity recursions.

Both are the same recursion, without and with the gain:
x̂[k+1] = Φ x̂[k] + Γ0 ū[k] + Γ1 ū[k+1] + γ + K ε[k],  ε[k] = y[k] - C x̂[k] - D ū[k] - d.

Output error, report (2) with the weights that maximum likelihood gives the outputs: residuals are ε = y -
simulated output, their variances σ_j² are those that maximise the likelihood, and the initial states minimise
the weighted squares; both are eliminated exactly at every θ.

Prediction error: the filter of a record starts with the mean x0, which is estimated, and the stationary
covariance (see `kalman_gains`); the value is that of the time-varying Kalman filter with the same start. x0
maximises the likelihood at every point of the search and is eliminated exactly, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from daest.estimation.fitting.coordinates import Unknowns
from daest.estimation.fitting.identifiability import Scores, initial_state, scores
from daest.estimation.fitting.records import Record, observed_counts
from daest.estimation.fitting.search import Objective
from daest.estimation.gates import FIT
from daest.estimation.linear.delay_starts import long_past, steady_past
from daest.model.holds import Hold
from daest.model.linear import StateSpace, StateSpaceFamily
from daest.numerics.exponential import near_periods
from daest.numerics.recursions import linear_recursion, varying_recursion
from daest.numerics.riccati import (
    Gains,
    NoiseModel,
    forgetting_model,
    stationary_gain_derivatives,
    stationary_gains,
    varying_gains,
)
from daest.numerics.tables import turned
from daest.systems.linear.state_space import (
    Noise,
    SampledDerivatives,
    sample,
    sample_derivatives,
    sample_steps,
    state_space,
    state_space_derivatives,
)

CHEBYSHEV_NODES = 20  # for an octave of step lengths; e^(A h) is smooth in h: the error is at rounding level
OCTAVE_REACH = 2.1  # |A| h / 4 up to which that holds: x^20 / 20! is 1e-12, as it is for fewer over less
LAST_TERM = -27.6  # its logarithm


@dataclass(frozen=True)
class NoiseLevels:
    """Intensity of w (n_w, n_w), how it is sampled, and covariance of e (n_y, n_y); with their derivatives in
    the p directions of the search."""

    intensity: np.ndarray
    intensity_slope: np.ndarray  # (p, n_w, n_w)
    measurement_cov: np.ndarray
    measurement_slope: np.ndarray  # (p, n_y, n_y)
    sampled: Noise


@dataclass(frozen=True)
class Recursion:
    """Matrices of the recursion over the steps of a record: constant, or with an axis of n_samples - 1 steps.

    `slope` holds their derivatives, with a leading axis of p directions.
    """

    Phi: np.ndarray
    now: np.ndarray
    following: np.ndarray
    drift: np.ndarray
    C: np.ndarray
    D: np.ndarray
    d: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    S12: np.ndarray
    is_constant: bool
    slope: SampledDerivatives | None


@dataclass(frozen=True)
class Innovations:
    """Residuals of a record that are linear in the initial state x0: ε = at_zero - response · x0.

    `at_zero` (n_samples, n_y), `response` (n, n_samples, n_y); missing values are zero. `S` (…, n_y, n_y)
    with an axis of samples unless constant, `S_slope` with a leading axis of p; both None without a
    Kalman filter.
    """

    at_zero: np.ndarray
    response: np.ndarray
    states_at_zero: np.ndarray
    states_response: np.ndarray
    S: np.ndarray | None
    S_slope: np.ndarray | None
    K: np.ndarray | None
    K_slope: np.ndarray | None


def recursion(
    ss: StateSpace,
    record: Record,
    hold: Hold,
    noise: NoiseLevels | None = None,
    derivatives: dict[str, np.ndarray] | None = None,
) -> Recursion:
    """Sample `ss` for the steps of a record; with `derivatives` (p directions) also the slopes. A derivative
    of a matrix (n, m) is (p, n, m)."""
    if record.period is not None or record.n_samples < 2:
        return _one_step(ss, record.period or 1.0, hold, noise, derivatives)
    found = _at_once(ss, record, hold, noise, derivatives)
    if found is not None:
        return found
    nodes, weights = _interpolation(record)
    return _combined([_one_step(ss, float(h), hold, noise, derivatives) for h in nodes], weights)


def kalman_gains(dyn: Recursion, record: Record) -> tuple[Gains, Gains | None] | None:
    """Gains and their derivatives for a record; None when the covariance does not settle.

    The filter starts with the stationary covariance P, around a mean that is estimated. For complete
    uniform records it is then stationary from the first sample: nothing is approximated. Otherwise it is
    time-varying. Directions of the state that no output sees and that never settle are left out of P.
    """
    noise, change = forgetting_model(NoiseModel(dyn.Phi, dyn.C, dyn.Q, dyn.R, dyn.S12), _noise_slope(dyn))
    typical = noise if dyn.is_constant else _typical(noise)
    start = stationary_gains(typical)
    if start is None:
        return None
    if dyn.is_constant and record.is_complete:
        if change is None:
            return start, None
        slope = stationary_gain_derivatives(noise, start, change)
        return None if slope is None else (start, slope)
    if change is None:
        change = _no_directions(noise)
    usual = change if dyn.is_constant else _typical(change)
    start_slope = stationary_gain_derivatives(typical, start, usual)
    if start_slope is None:
        return None
    return varying_gains(noise, change, record.observed, start.P, start_slope.P)


def innovations(
    dyn: Recursion,
    record: Record,
    gains: tuple[Gains, Gains | None] | None,
    held: np.ndarray | None = None,
) -> Innovations:
    """Residuals for x0 = 0 and their response to every initial state, none to those that are `held` (n,)
    at zero."""
    K = None if gains is None else gains[0].K
    u, n = record.inputs, dyn.Phi.shape[-1]
    known = record.outputs - u @ turned(dyn.D) - dyn.d
    drive = _times(dyn.now, u[:-1]) + _times(dyn.following, u[1:]) + dyn.drift
    if K is not None:
        drive = drive + _times(_steps(K), known[:-1] * record.observed[:-1])
    drives = np.zeros((n + 1, record.n_samples - 1, n))
    drives[0] = drive
    free = np.ones(n) if held is None else ~held
    starts = np.vstack([np.zeros((1, n)), np.diag(free.astype(float))])
    states = _recursion(_closed(dyn, K), drives, starts)
    seen = record.observed
    slope = None if gains is None else gains[1]
    return Innovations(
        at_zero=(known - states[0] @ turned(dyn.C)) * seen,
        response=(states[1:] @ turned(dyn.C)) * seen,
        states_at_zero=states[0],
        states_response=states[1:],
        S=None if gains is None else gains[0].S,
        S_slope=None if slope is None else slope.S,
        K=K,
        K_slope=None if slope is None else slope.K,
    )


def innovation_slopes(dyn: Recursion, record: Record, found: Innovations, x0: np.ndarray) -> np.ndarray:
    """∂ε/∂direction (p, n_samples, n_y) for the initial state x0 (n,), zero where an output is missing."""
    slope, u, seen = dyn.slope, record.inputs, record.observed
    assert slope is not None
    states = found.states_at_zero + np.tensordot(x0, found.states_response, 1)
    eps = found.at_zero - np.tensordot(x0, found.response, 1)
    if dyn.is_constant and record.is_complete and (found.K is None or found.K.ndim == 2):
        return _constant_slopes(dyn, u, found, states, eps)
    direct = states @ turned(slope.output) + u @ turned(slope.feedthrough) + slope.output_offset[:, None, :]
    drive = _times(slope.transition, states[:-1], 1) + _times(slope.input_now, u[:-1], 1)
    drive = drive + _times(slope.input_next, u[1:], 1)
    drive = drive + (slope.drift[:, None, :] if slope.drift.ndim == 2 else slope.drift)
    if found.K is not None and found.K_slope is not None:
        drive = drive + _times(_steps(found.K_slope, 1), eps[:-1], 1)
        drive = drive - _times(_steps(found.K), direct[:, :-1] * seen[:-1])
    start = np.zeros((drive.shape[0], drive.shape[2]))
    moved = _recursion(_closed(dyn, found.K), drive, start)
    return -(moved @ turned(dyn.C) + direct) * seen


def _constant_slopes(
    dyn: Recursion, u: np.ndarray, found: Innovations, states: np.ndarray, eps: np.ndarray
) -> np.ndarray:
    """`innovation_slopes` where one step is as the other and no output is missing: what drives a direction is
    then one product with all signals of a sample beside each other."""
    slope = dyn.slope
    assert slope is not None
    p, n, n_u = slope.transition.shape[0], states.shape[1], u.shape[1]
    n_y = dyn.C.shape[0]
    signals = np.hstack([states[:-1], u[:-1], np.ones((u.shape[0] - 1, 1)), u[1:], eps[:-1]])
    direct = np.concatenate([slope.output, slope.feedthrough, slope.output_offset[:, :, None]], axis=2)
    moves = np.concatenate([slope.transition, slope.input_now, slope.drift[:, :, None]], axis=2)
    by_gain = np.zeros((p, n, n_y))
    if found.K is not None and found.K_slope is not None:
        by_gain = found.K_slope
        moves = moves - found.K @ direct
    drive = signals @ turned(np.concatenate([moves, slope.input_next, by_gain], axis=2))
    moved = linear_recursion(_closed(dyn, found.K), drive, np.zeros((p, n)))
    last = np.hstack([states[-1:], u[-1:], [[1.0]]])
    at_samples = np.vstack([signals[:, : n + n_u + 1], last])
    return -(moved @ turned(dyn.C)) - at_samples @ turned(direct)


def _one_step(
    ss: StateSpace,
    period: float,
    hold: Hold,
    noise: NoiseLevels | None,
    derivatives: dict[str, np.ndarray] | None,
) -> Recursion:
    slope = None
    if noise is None:
        model = sample(ss, period, hold)
        if derivatives is not None:
            slope = sample_derivatives(ss, derivatives, period, hold)
    else:
        model = sample(ss, period, hold, noise.intensity, noise.measurement_cov, noise.sampled)
        if derivatives is not None:
            slope = sample_derivatives(
                ss, derivatives, period, hold, noise.intensity, noise.intensity_slope, noise.sampled
            )
            slope = _with(slope, measurement_cov=slope.measurement_cov + noise.measurement_slope)
    return Recursion(
        Phi=model.transition,
        now=model.input_now,
        following=model.input_next,
        drift=model.drift,
        C=model.output,
        D=model.feedthrough,
        d=model.output_offset,
        Q=model.process_cov,
        R=model.measurement_cov,
        S12=model.cross_cov,
        is_constant=True,
        slope=slope,
    )


def _with(slope: SampledDerivatives, **changes: np.ndarray) -> SampledDerivatives:
    return SampledDerivatives(**{f.name: changes.get(f.name, getattr(slope, f.name)) for f in fields(slope)})


DYNAMIC_FIELDS = ("Phi", "now", "following", "drift", "Q", "S12")
DYNAMIC_SLOPES = ("transition", "input_now", "input_next", "drift", "process_cov", "cross_cov")


def _combined(parts: list[Recursion], weights: np.ndarray) -> Recursion:
    """Matrices of every step as sums over nodes: weights (n_steps, n_nodes)."""
    first = parts[0]
    values = {f.name: getattr(first, f.name) for f in fields(first)}
    for name in DYNAMIC_FIELDS:
        values[name] = np.tensordot(weights, np.array([getattr(part, name) for part in parts]), 1)
    if first.slope is not None:
        changes = {}
        for name in DYNAMIC_SLOPES:
            stacked = np.array([getattr(part.slope, name) for part in parts])
            changes[name] = np.swapaxes(np.tensordot(weights, stacked, 1), 0, 1)
        values["slope"] = _with(first.slope, **changes)
    return Recursion(**{**values, "is_constant": False})


def _interpolation(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Step lengths (n_nodes,) to sample at, and weights (n_steps, n_nodes) of them in every step of a
    record: e^(A h) is smooth in h, so that a few Chebyshev nodes do for many steps that are nearly equal."""
    octaves, which = record.octaves
    groups = [part for octave in octaves for part in _groups(octave)]
    found = [_group_weights(group) for group in groups]
    nodes = np.concatenate([one for one, _ in found])
    weights = np.zeros((sum(group.size for group in groups), nodes.size))
    row = column = 0
    for group, (own, block) in zip(groups, found, strict=True):
        weights[row : row + group.size, column : column + own.size] = block
        row, column = row + group.size, column + own.size
    return nodes, weights[which]


def _at_once(
    ss: StateSpace,
    record: Record,
    hold: Hold,
    noise: NoiseLevels | None,
    derivatives: dict[str, np.ndarray] | None,
) -> Recursion | None:
    """The recursion over the uneven steps of a record, from series about a few of them; None where those do
    not do."""
    if noise is not None and noise.sampled != "white":
        return None
    octaves, which = record.octaves
    levels = () if noise is None else (noise.intensity, noise.intensity_slope)

    known = []
    for octave in octaves:
        for periods in near_periods(ss.A, octave):
            part = sample_steps(ss, periods, hold, derivatives, *levels)
            if part is None:
                return None
            known.append(part)
    Phi, now, following, drift, Q = (
        np.take(np.concatenate([getattr(part, name) for part in known]), which, axis=0)
        for name in ("transition", "input_now", "input_next", "drift", "process_cov")
    )
    slopes = [part.slopes for part in known if part.slopes is not None]
    slope = None
    if slopes:
        changes = {
            name: np.take(np.concatenate([getattr(one, name) for one in slopes], axis=1), which, axis=1)
            for name in DYNAMIC_SLOPES
        }
        if noise is not None:
            changes["measurement_cov"] = noise.measurement_slope
        slope = _with(slopes[0], **changes)
    n_y, n = ss.C.shape
    return Recursion(
        Phi=Phi,
        now=now,
        following=following,
        drift=drift,
        C=ss.C,
        D=ss.D,
        d=ss.d,
        Q=Q,
        R=np.zeros((n_y, n_y)) if noise is None else noise.measurement_cov,
        S12=np.zeros((which.size, n, n_y)),
        is_constant=False,
        slope=slope,
    )


def _groups(distinct: np.ndarray) -> list[np.ndarray]:
    """Ascending step lengths within an octave, parted at the widest gaps as long as that saves nodes."""
    if distinct.size < 2:
        return [distinct]
    cut = int(np.argmax(np.diff(distinct))) + 1
    parts = distinct[:cut], distinct[cut:]
    if sum(map(_n_nodes, parts)) < _n_nodes(distinct):
        return [one for part in parts for one in _groups(part)]
    return [distinct]


def _n_nodes(distinct: np.ndarray) -> int:
    """How many nodes do for ascending step lengths within an octave: at most as many as there are."""
    reach = float(np.log(OCTAVE_REACH * max(distinct[-1] / distinct[0] - 1.0, np.finfo(float).tiny)))
    enough = (n for n in range(1, CHEBYSHEV_NODES) if n * reach - math.lgamma(n + 1) < LAST_TERM)
    return min(distinct.size, next(enough, CHEBYSHEV_NODES))


def _group_weights(distinct: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n,) of a group and barycentric weights (n_distinct, n)."""
    n = _n_nodes(distinct)
    if n == distinct.size:
        return distinct, np.eye(n)
    angles = np.pi * (2 * np.arange(n) + 1) / (2 * n)
    middle, half = (distinct[0] + distinct[-1]) / 2.0, (distinct[-1] - distinct[0]) / 2.0
    points = middle + half * np.cos(angles)
    distance = distinct[:, None] - points
    exact = distance == 0.0
    raw = (-1.0) ** np.arange(n) * np.sin(angles) / np.where(exact, 1.0, distance)
    raw[np.any(exact, axis=1)] = 0.0
    raw[exact] = 1.0
    return points, raw / raw.sum(axis=1, keepdims=True)


def _noise_slope(dyn: Recursion) -> NoiseModel | None:
    s = dyn.slope
    return (
        None
        if s is None
        else NoiseModel(s.transition, s.output, s.process_cov, s.measurement_cov, s.cross_cov)
    )


def _no_directions(noise: NoiseModel) -> NoiseModel:
    return NoiseModel(*(np.zeros((0, *getattr(noise, f.name).shape)) for f in fields(noise)))


def _typical(noise: NoiseModel) -> NoiseModel:
    """The mean over the steps, for a start covariance."""
    return NoiseModel(
        noise.Phi.mean(axis=-3), noise.C, noise.Q.mean(axis=-3), noise.R, noise.S12.mean(axis=-3)
    )


def _closed(dyn: Recursion, K: np.ndarray | None) -> np.ndarray:
    """Φ - K C, with an axis of steps where anything varies."""
    if K is None:
        return dyn.Phi
    return dyn.Phi - _steps(K) @ dyn.C


def _steps(K: np.ndarray, lead: int = 0) -> np.ndarray:
    """Gains of the steps: those of all samples but the last, or the constant one."""
    return K if K.ndim == 2 + lead else K[..., :-1, :, :]


def _times(matrix: np.ndarray, rows: np.ndarray, lead: int = 0) -> np.ndarray:
    """matrix · row for every row: matrix (lead axes, [n_steps,] a, b), rows (…, n_steps, b)."""
    if matrix.ndim == 2 + lead:
        return rows @ turned(matrix)
    if matrix.shape[-1] == 1:
        return matrix[..., 0] * rows  # in a third of the time
    return (matrix @ rows[..., None])[..., 0]


def _recursion(closed: np.ndarray, drive: np.ndarray, start: np.ndarray) -> np.ndarray:
    """States (m, n_samples, n) of m right-hand sides; `closed` (n, n) or one matrix per step."""
    if closed.ndim == 2:
        return linear_recursion(closed, drive, start)
    return varying_recursion(closed, drive, start)


WEIGHT_ITERATIONS = 20


@dataclass(frozen=True)
class Problem:
    """What is fitted to what: the `Predictor` of a linear model. `weigh` (n_y,) tells which measurement
    noises are found (else they are given)."""

    family: StateSpaceFamily
    records: tuple[Record, ...]
    hold: Hold
    unknowns: Unknowns
    weigh: np.ndarray
    sampled: Noise = "white"  # how process noise is sampled
    is_filtered: bool = False  # one-step predictions of the Kalman filter; else the simulation
    begins_level: bool = False  # what long delays keep is no curve when a record begins

    def predict(self, z: np.ndarray, with_slopes: bool = False) -> Predicted | None:
        """At a point of the search; None where a simulation overflows or the filter does not exist."""
        if self.is_filtered:
            return predict(self, z, with_slopes)
        theta, _, std = self.unknowns.values(z)
        return simulate(self, theta, std, with_slopes)

    def derivatives(self, found: Predicted, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and Fisher information along z. Shapes: z (n_z,); gradient (n_z,), information (n_z,
        n_z)."""
        slopes = self.unknowns.slopes(z)
        gradient, information = np.zeros(slopes.size), np.zeros((slopes.size, slopes.size))
        for part, innovation, record in zip(all_scores(found), found.found, self.records, strict=True):
            by_mean = np.tensordot(part.slopes, part.residuals, 2)
            squares = np.tensordot(part.slopes, part.slopes, ((1, 2), (1, 2)))
            if innovation.S_slope is not None:
                more = _variance_scores(part, innovation, record)
                by_mean, squares = by_mean + more[0], squares + more[1]
            gradient += by_mean
            information += squares
        return gradient * slopes, information * np.outer(slopes, slopes)

    def tied(self, likelihood: Objective) -> Objective:
        """States of a linear model are free."""
        return likelihood


@dataclass(frozen=True)
class Predicted:
    """Predictions of all records at one point: innovations for x0 = 0, the initial means, the measurement
    noise std (n_y,), and the gains of the filter; none for a simulation."""

    records: tuple[Record, ...]
    found: tuple[Innovations, ...]
    recursions: tuple[Recursion, ...]
    gains: tuple[Gains, ...]
    initial_states: tuple[np.ndarray, ...]
    measurement_std: np.ndarray
    negative_log_likelihood: float


def simulate(
    problem: Problem, theta: np.ndarray, given_std: np.ndarray, with_slopes: bool = False
) -> Predicted | None:
    """Simulate every record from its best initial state; None where the outputs overflow. Shapes: theta
    (n_theta,), given_std (n_y,)."""
    with np.errstate(all="ignore"):
        ss = state_space(problem.family, theta)
        derivatives = None
        if with_slopes:
            names = problem.unknowns.parameter_names()
            derivatives = state_space_derivatives(problem.family, theta, names)
        made = shared_recursions(ss, problem, None, derivatives)
        if made is None:
            return None
        parts = zip(made, problem.records, _held_starts(problem, ss), strict=True)
        found = tuple(innovations(dyn, record, None, held) for dyn, record, held in parts)
        if not all(np.all(np.isfinite(f.at_zero)) and np.all(np.isfinite(f.response)) for f in found):
            return None
        std, states = _weights_and_states(problem, found, given_std)
        value = _simulation_value(problem, found, states, std)
    return Predicted(problem.records, found, made, (), states, std, value)


def predict(problem: Problem, z: np.ndarray, with_slopes: bool = False) -> Predicted | None:
    """One-step predictions at a point of the search; None where the filter does not exist or overflows.
    Shapes: z (p,)."""
    theta, intensity, std = problem.unknowns.values(z)
    with np.errstate(all="ignore"):
        ss = state_space(problem.family, theta)
        derivatives = matrix_slopes(problem, theta) if with_slopes else None
        made = shared_recursions(ss, problem, noise_levels(problem, intensity, std), derivatives)
        if made is None:
            return None
        found, gains, states, value = [], [], [], 0.0
        for dyn, record, held in zip(made, problem.records, _held_starts(problem, ss), strict=True):
            kalman = kalman_gains(dyn, record)
            if kalman is None:
                return None
            residuals = innovations(dyn, record, kalman, held)
            if not (np.all(np.isfinite(residuals.at_zero)) and np.all(np.isfinite(residuals.response))):
                return None
            rows = np.concatenate([residuals.at_zero[None], residuals.response])
            try:
                whitened = _whiten(residuals.S, std, rows)
            except np.linalg.LinAlgError:  # a covariance that rounding leaves without a root
                return None
            x0 = initial_state(whitened[1:].reshape(len(whitened) - 1, whitened[0].size), whitened[0].ravel())
            rest = whitened[0] - np.tensordot(x0, whitened[1:], 1)
            value += _record_value(rest, residuals.S, record)
            found.append(residuals)
            gains.append(kalman[0])
            states.append(x0)
    if not np.isfinite(value):
        return None
    return Predicted(problem.records, tuple(found), made, tuple(gains), tuple(states), std, value)


def _held_starts(problem: Problem, ss: StateSpace) -> Iterator[np.ndarray]:
    """The states (n,) of every record that begin at zero."""
    names = problem.family.state_names
    for record in problem.records:
        held = steady_past(names, ss.A != 0.0, ss.B != 0.0, record.inputs)
        if problem.begins_level and record.n_samples > 1:
            held = held | long_past(names, ss.A.__matmul__, float(np.median(np.diff(record.time))))
        yield held


def shared_recursions(
    ss: StateSpace,
    problem: Problem,
    noise: NoiseLevels | None,
    derivatives: dict[str, np.ndarray] | None,
) -> tuple[Recursion, ...] | None:
    """Recursion of every record, sampled once per period; None when the sampled matrices are not finite. A
    derivative of a matrix (n, m) is (p, n, m)."""
    by_period: dict[float, Recursion] = {}
    result = []
    for record in problem.records:
        if record.period is None or record.period not in by_period:
            dyn = recursion(ss, record, problem.hold, noise, derivatives)
            if record.period is not None:
                by_period[record.period] = dyn
        else:
            dyn = by_period[record.period]
        result.append(dyn)
    finite = all(np.all(np.isfinite(m)) for d in result for m in (d.Phi, d.now, d.following, d.drift, d.Q))
    return tuple(result) if finite else None


def all_scores(predicted: Predicted) -> list[Scores]:
    """Whitened residuals and projected slopes of every record."""
    parts = []
    rows = zip(
        predicted.records, predicted.recursions, predicted.found, predicted.initial_states, strict=True
    )
    for record, dyn, found, x0 in rows:
        slopes = innovation_slopes(dyn, record, found, x0)
        residuals = found.at_zero - np.tensordot(x0, found.response, 1)
        whole = np.concatenate([residuals[None], found.response, slopes])
        stacked = _whiten(found.S, predicted.measurement_std, whole)
        n = found.response.shape[0]
        parts.append(scores(stacked[0], stacked[1 : n + 1], stacked[n + 1 :]))
    return parts


def noise_levels(problem: Problem, intensity: np.ndarray, std: np.ndarray) -> NoiseLevels:
    """Noise at one point, and its derivatives in all directions of the search. Shapes: intensity (n_w,),
    std (n_y,)."""
    coordinates = problem.unknowns.coordinates
    p, n_w, n_y = len(coordinates), intensity.size, std.size
    dW, dR = np.zeros((p, n_w, n_w)), np.zeros((p, n_y, n_y))
    for i, coordinate in enumerate(coordinates):
        if coordinate.kind == "process":
            dW[i, coordinate.index, coordinate.index] = 1.0
        elif coordinate.kind == "measurement":
            dR[i, coordinate.index, coordinate.index] = 2.0 * std[coordinate.index]
    return NoiseLevels(np.diag(intensity), dW, np.diag(std**2), dR, problem.sampled)


def matrix_slopes(problem: Problem, theta: np.ndarray) -> dict[str, np.ndarray]:
    """Derivatives of the state space in all directions: parameters first, then zeros for the noises.
    Shapes: theta (n_theta,); of a matrix (n, m) the slopes (d, n, m)."""
    names = problem.unknowns.parameter_names()
    extra = len(problem.unknowns.coordinates) - len(names)
    exact = state_space_derivatives(problem.family, theta, names)
    return {
        name: np.concatenate([array, np.zeros((extra, *array.shape[1:]))]) for name, array in exact.items()
    }


def _weights_and_states(
    problem: Problem, found: tuple[Innovations, ...], given_std: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """σ (n_y,) and x0 of every record that maximise the likelihood together.

    Each output of each record is compressed to a small triangle first, so that the iteration costs nothing.
    """
    triangles = [_triangles(f) for f in found]
    counts = observed_counts(problem.records)
    floor = FIT.smallest_std * _sizes(problem.records)
    weigh = problem.weigh & (counts > 0)
    std = np.where(weigh, np.maximum(_rms(triangles, counts), floor), given_std)
    states: tuple[np.ndarray, ...] = ()
    for _ in range(WEIGHT_ITERATIONS):
        states = tuple(_state_from(t, std) for t in triangles)
        squares = sum(_squares(t, x0) for t, x0 in zip(triangles, states, strict=True))
        before, rms = std, np.sqrt(squares / np.maximum(counts, 1))
        std = np.where(weigh, np.maximum(rms, floor), given_std)
        if np.all(np.abs(std - before) <= FIT.settled_weights * std):
            break
    return std, states


def _triangles(found: Innovations) -> np.ndarray:
    """R of [response, residual] per output, (n_y, n + 1, n + 1)."""
    n_y = found.at_zero.shape[1]
    result = []
    for j in range(n_y):
        table = np.column_stack([found.response[:, :, j].T, found.at_zero[:, j]])
        if table.shape[0] < table.shape[1]:
            table = np.vstack([table, np.zeros((table.shape[1] - table.shape[0], table.shape[1]))])
        result.append(np.linalg.qr(table, mode="r"))
    return np.array(result)


def _state_from(triangles: np.ndarray, std: np.ndarray) -> np.ndarray:
    table = np.concatenate([t / s for t, s in zip(triangles, std, strict=True)])
    return initial_state(table[:, :-1].T, table[:, -1])


def _squares(triangles: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """Sum of squared residuals per output."""
    return np.sum((triangles[:, :, -1] - triangles[:, :, :-1] @ x0) ** 2, axis=1)


def _rms(triangles: list[np.ndarray], counts: np.ndarray) -> np.ndarray:
    """rms per output when each output has its own best initial state: a start for the weights."""
    squares = sum(t[:, -1, -1] ** 2 for t in triangles)
    return np.sqrt(squares / np.maximum(counts, 1))


def _sizes(records: tuple[Record, ...]) -> np.ndarray:
    """rms of every measured output over all records, 1 for an output of zeros."""
    squares = sum(np.sum(r.outputs**2, axis=0) for r in records)
    size = np.sqrt(squares / np.maximum(observed_counts(records), 1))
    return np.where(size > 0.0, size, 1.0)


def _simulation_value(
    problem: Problem, found: tuple[Innovations, ...], states: tuple[np.ndarray, ...], std: np.ndarray
) -> float:
    """Negative log-likelihood of all records."""
    counts = observed_counts(problem.records)
    squares = sum(
        np.sum((f.at_zero - np.tensordot(x0, f.response, 1)) ** 2, axis=0)
        for f, x0 in zip(found, states, strict=True)
    )
    return float(np.sum(counts * np.log(2 * np.pi * std**2) + squares / std**2) / 2)


def _whiten(S: np.ndarray | None, std: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """L⁻¹ row with S = L Lᵀ, for rows (m, n_samples, n_y); S constant or one per sample, None: diag(std²)."""
    if S is None:
        return rows * (1.0 / std)
    if S.ndim == 3 and S.shape[-1] == 1:  # in a tenth of the time
        if not np.all(S > 0.0):
            raise np.linalg.LinAlgError("a covariance is not positive")
        return rows * (1.0 / np.sqrt(S[:, :, 0]))
    root = np.linalg.cholesky(S)
    if S.ndim == 2:
        return rows @ turned(np.linalg.inv(root))
    return (np.linalg.inv(root) @ rows[..., None])[..., 0]


def _record_value(rest: np.ndarray, S: np.ndarray | None, record: Record) -> float:
    """Negative log-likelihood of one record from its whitened innovations."""
    assert S is not None
    log_determinants = np.linalg.slogdet(S)[1] * (record.n_samples if S.ndim == 2 else 1)
    constant = np.log(2 * np.pi) * float(np.sum(record.n_observed))
    return float((np.sum(rest**2) + np.sum(log_determinants) + constant) / 2)


def _variance_scores(part: Scores, found: Innovations, record: Record) -> tuple[np.ndarray, np.ndarray]:
    """The part of gradient and information that comes from the changing innovation covariance."""
    assert found.S is not None and found.S_slope is not None
    inverse = np.linalg.inv(np.linalg.cholesky(found.S))
    change = inverse @ found.S_slope @ np.swapaxes(inverse, -1, -2)
    if found.S.ndim == 2:
        moment = part.residuals.T @ part.residuals
        trace = np.trace(change, axis1=1, axis2=2) * record.n_samples
        gradient = (trace - np.tensordot(change, moment, 2)) / 2
        return gradient, np.tensordot(change, change, ((1, 2), (1, 2))) * record.n_samples / 2
    quadratic = np.einsum("ka,pkab,kb->p", part.residuals, change, part.residuals)
    gradient = (np.trace(change, axis1=2, axis2=3).sum(axis=1) - quadratic) / 2
    return gradient, np.tensordot(change, change, ((1, 2, 3), (1, 2, 3))) / 2
