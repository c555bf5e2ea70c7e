"""Predictors of linear models: the simulation, and the one-step predictions of the Kalman filter.

Output error, report (2) with the weights that maximum likelihood gives the outputs: residuals are ε = y -
simulated output, their variances σ_j² are those that maximise the likelihood, and the initial states minimise
the weighted squares; both are eliminated exactly at every θ.

Prediction error: the filter of a record starts with the mean x0, which is estimated, and the stationary
covariance (see `predictor.kalman_gains`); the value is that of the time-varying Kalman filter with the same
start. x0 maximises the likelihood at every point of the search and is eliminated exactly, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daest.estimation.coordinates import Unknowns
from daest.estimation.gates import FIT
from daest.estimation.identifiability import Scores, initial_state, scores
from daest.estimation.predictor import (
    Innovations,
    NoiseLevels,
    Recursion,
    innovation_slopes,
    innovations,
    kalman_gains,
    recursion,
)
from daest.estimation.records import Record, observed_counts
from daest.estimation.search import Objective
from daest.model.linear import StateSpace, StateSpaceFamily
from daest.numerics.innovations import Gains
from daest.systems.sample import Hold, Noise
from daest.systems.state_space import state_space, state_space_derivatives

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

    def predict(self, z: np.ndarray, with_slopes: bool = False) -> Predicted | None:
        """At a point of the search; None where a simulation overflows or the filter does not exist."""
        if self.is_filtered:
            return predict(self, z, with_slopes)
        theta, _, std = self.unknowns.values(z)
        return simulate(self, theta, std, with_slopes)

    def derivatives(self, found: Predicted, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and Fisher information along z."""
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
    """Simulate every record from its best initial state; None where the outputs overflow."""
    with np.errstate(all="ignore"):
        ss = state_space(problem.family, theta)
        derivatives = None
        if with_slopes:
            names = problem.unknowns.parameter_names()
            derivatives = state_space_derivatives(problem.family, theta, names)
        made = shared_recursions(ss, problem, None, derivatives)
        if made is None:
            return None
        found = tuple(innovations(d, r, None) for d, r in zip(made, problem.records, strict=True))
        if not all(np.all(np.isfinite(f.at_zero)) and np.all(np.isfinite(f.response)) for f in found):
            return None
        std, states = _weights_and_states(problem, found, given_std)
        value = _simulation_value(problem, found, states, std)
    return Predicted(problem.records, found, made, (), states, std, value)


def predict(problem: Problem, z: np.ndarray, with_slopes: bool = False) -> Predicted | None:
    """One-step predictions at a point of the search; None where the filter does not exist or overflows."""
    theta, intensity, std = problem.unknowns.values(z)
    with np.errstate(all="ignore"):
        ss = state_space(problem.family, theta)
        derivatives = matrix_slopes(problem, theta) if with_slopes else None
        made = shared_recursions(ss, problem, noise_levels(problem, intensity, std), derivatives)
        if made is None:
            return None
        found, gains, states, value = [], [], [], 0.0
        for dyn, record in zip(made, problem.records, strict=True):
            kalman = kalman_gains(dyn, record)
            if kalman is None:
                return None
            residuals = innovations(dyn, record, kalman)
            if not (np.all(np.isfinite(residuals.at_zero)) and np.all(np.isfinite(residuals.response))):
                return None
            rows = np.concatenate([residuals.at_zero[None], residuals.response])
            try:
                whitened = _whiten(residuals.S, std, rows)
            except np.linalg.LinAlgError:  # a covariance that rounding leaves without a root
                return None
            x0 = initial_state(whitened[1:].reshape(len(whitened) - 1, -1), whitened[0].ravel())
            rest = whitened[0] - np.tensordot(x0, whitened[1:], 1)
            value += _record_value(rest, residuals.S, record)
            found.append(residuals)
            gains.append(kalman[0])
            states.append(x0)
    if not np.isfinite(value):
        return None
    return Predicted(problem.records, tuple(found), made, tuple(gains), tuple(states), std, value)


def shared_recursions(
    ss: StateSpace,
    problem: Problem,
    noise: NoiseLevels | None,
    derivatives: dict[str, np.ndarray] | None,
) -> tuple[Recursion, ...] | None:
    """Recursion of every record, sampled once per period; None when the sampled matrices are not finite."""
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
    """Noise at one point, and its derivatives in all directions of the search."""
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
    """Derivatives of the state space in all directions: parameters first, then zeros for the noises."""
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
    root = np.linalg.cholesky(S)
    if S.ndim == 2:
        return rows @ np.linalg.inv(root).T
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
