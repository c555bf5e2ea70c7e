"""Gaussian likelihood through the Kalman filter, with exact gradient and Fisher information.

The filter of a record starts with the mean x0, which is estimated, and the stationary covariance (see
`predictor.kalman_gains`); the value is that of the time-varying Kalman filter with the same start. x0
maximises the likelihood at every point of the search and is eliminated exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daest.estimation.coordinates import with_priors
from daest.estimation.identifiability import Scores, initial_state, scores
from daest.estimation.output_error import Problem, shared_dynamics
from daest.estimation.predictor import (
    Innovations,
    NoiseLevels,
    Recursion,
    innovation_slopes,
    innovations,
    kalman_gains,
)
from daest.estimation.records import Record
from daest.estimation.search import Evaluation
from daest.numerics.innovations import Gains
from daest.systems.state_space import state_space, state_space_derivatives


@dataclass(frozen=True)
class Predicted:
    """One-step predictions of all records at one point: innovations, gains and the initial means."""

    found: tuple[Innovations, ...]
    dynamics: tuple[Recursion, ...]
    gains: tuple[Gains, ...]
    initial_states: tuple[np.ndarray, ...]
    negative_log_likelihood: float


def objective(problem: Problem) -> Callable[[np.ndarray, bool], Evaluation | None]:
    """Negative log-likelihood and priors over all search coordinates."""

    @np.errstate(all="ignore")  # where numbers overflow, there is no value
    def evaluate(z: np.ndarray, with_slopes: bool) -> Evaluation | None:
        predicted = predict(problem, z, with_slopes)
        if predicted is None:
            return None
        if not with_slopes:
            return Evaluation(predicted.negative_log_likelihood)
        slopes = problem.unknowns.slopes(z)
        gradient, information = np.zeros(slopes.size), np.zeros((slopes.size, slopes.size))
        for part, found, record in zip(
            all_scores(problem, predicted), predicted.found, problem.records, strict=True
        ):
            more = _variance_scores(part, found, record)
            gradient += np.tensordot(part.slopes, part.residuals, 2) + more[0]
            information += np.tensordot(part.slopes, part.slopes, ((1, 2), (1, 2))) + more[1]
        gradient, information = gradient * slopes, information * np.outer(slopes, slopes)
        if not (np.all(np.isfinite(gradient)) and np.all(np.isfinite(information))):
            return None
        return Evaluation(predicted.negative_log_likelihood, gradient, information)

    return with_priors(evaluate, problem.unknowns)


def predict(problem: Problem, z: np.ndarray, with_slopes: bool = False) -> Predicted | None:
    """One-step predictions at a point of the search; None where the filter does not exist or overflows."""
    theta, intensity, std = problem.unknowns.values(z)
    with np.errstate(all="ignore"):
        ss = state_space(problem.family, theta)
        derivatives = matrix_slopes(problem, theta) if with_slopes else None
        dyns = shared_dynamics(ss, problem, noise_levels(problem, intensity, std), derivatives)
        if dyns is None:
            return None
        found, gains, states, value = [], [], [], 0.0
        for dyn, record in zip(dyns, problem.records, strict=True):
            kalman = kalman_gains(dyn, record)
            if kalman is None:
                return None
            residuals = innovations(dyn, record, kalman)
            if not (np.all(np.isfinite(residuals.at_zero)) and np.all(np.isfinite(residuals.response))):
                return None
            try:
                whitened = _whiten(residuals.S, np.concatenate([residuals.at_zero[None], residuals.response]))
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
    return Predicted(tuple(found), dyns, tuple(gains), tuple(states), value)


def all_scores(problem: Problem, predicted: Predicted) -> list[Scores]:
    """Whitened innovations and projected slopes of every record."""
    parts = []
    rows = zip(problem.records, predicted.dynamics, predicted.found, predicted.initial_states, strict=True)
    for record, dyn, found, x0 in rows:
        slopes = innovation_slopes(dyn, record, found, x0)
        residuals = found.at_zero - np.tensordot(x0, found.response, 1)
        stacked = _whiten(found.S, np.concatenate([residuals[None], found.response, slopes]))
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


def _whiten(S: np.ndarray | None, rows: np.ndarray) -> np.ndarray:
    """L⁻¹ row with S = L Lᵀ, for rows (m, n_samples, n_y); S constant or one per sample."""
    assert S is not None
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
