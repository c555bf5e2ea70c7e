"""Output error: report (2) with the weights that maximum likelihood gives the outputs.

Residuals are ε = y - simulated output, their variances σ_j² are those that maximise the likelihood, and the
initial states minimise the weighted squares; both are eliminated exactly at every θ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daest.estimation.coordinates import Unknowns, with_priors
from daest.estimation.identifiability import Scores, initial_state, scores
from daest.estimation.predictor import (
    Innovations,
    NoiseLevels,
    Recursion,
    innovation_slopes,
    innovations,
    recursion,
)
from daest.estimation.records import Record, observed_counts
from daest.estimation.search import Evaluation
from daest.model.linear import StateSpace, StateSpaceFamily
from daest.systems.sample import Hold, Noise
from daest.systems.state_space import state_space, state_space_derivatives

WEIGHT_ITERATIONS = 20
WEIGHT_TOLERANCE = 1e-9  # relative change of the variances that ends their iteration
SMALLEST_STD = 1e-9  # of a residual, relative to the rms of its output: keeps noise-free data finite


@dataclass(frozen=True)
class Problem:
    """What is fitted to what. `weigh` (n_y,) tells which measurement noises are found (else they are
    given).
    """

    family: StateSpaceFamily
    records: tuple[Record, ...]
    hold: Hold
    unknowns: Unknowns
    weigh: np.ndarray
    sampled: Noise = "white"  # how process noise is sampled


@dataclass(frozen=True)
class Simulated:
    """Residuals of all records at one θ: innovations for x0 = 0, the initial states, and the noise std
    (n_y,).
    """

    found: tuple[Innovations, ...]
    dynamics: tuple[Recursion, ...]
    initial_states: tuple[np.ndarray, ...]
    measurement_std: np.ndarray


def objective(problem: Problem) -> Callable[[np.ndarray, bool], Evaluation | None]:
    """Negative log-likelihood and priors over the coordinates of the parameters (no noise coordinates)."""

    @np.errstate(all="ignore")  # where numbers overflow, there is no value
    def evaluate(z: np.ndarray, with_slopes: bool) -> Evaluation | None:
        theta, _, std = problem.unknowns.values(z)
        simulated = simulate(problem, theta, std, with_slopes)
        if simulated is None:
            return None
        value = _negative_log_likelihood(problem, simulated)
        if not np.isfinite(value):
            return None
        if not with_slopes:
            return Evaluation(value)
        parts = all_scores(problem, simulated)
        slopes = problem.unknowns.slopes(z)
        gradient = sum(np.tensordot(s.slopes, s.residuals, 2) for s in parts) * slopes
        information = sum(np.tensordot(s.slopes, s.slopes, ((1, 2), (1, 2))) for s in parts)
        information = information * np.outer(slopes, slopes)
        if not (np.all(np.isfinite(gradient)) and np.all(np.isfinite(information))):
            return None
        return Evaluation(value, gradient, information)

    return with_priors(evaluate, problem.unknowns)


def simulate(
    problem: Problem, theta: np.ndarray, given_std: np.ndarray, with_slopes: bool = False
) -> Simulated | None:
    """Simulate every record from its best initial state; None where the outputs overflow."""
    with np.errstate(all="ignore"):
        ss = state_space(problem.family, theta)
        derivatives = None
        if with_slopes:
            names = problem.unknowns.parameter_names()
            derivatives = state_space_derivatives(problem.family, theta, names)
        dyns = shared_dynamics(ss, problem, None, derivatives)
        if dyns is None:
            return None
        found = tuple(innovations(d, r, None) for d, r in zip(dyns, problem.records, strict=True))
        if not all(np.all(np.isfinite(f.at_zero)) and np.all(np.isfinite(f.response)) for f in found):
            return None
        std, states = _weights_and_states(problem, found, given_std)
    return Simulated(found, dyns, states, std)


def shared_dynamics(
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


def all_scores(problem: Problem, simulated: Simulated) -> list[Scores]:
    """Whitened residuals and projected slopes of every record."""
    weight = 1.0 / simulated.measurement_std
    parts = []
    rows = zip(problem.records, simulated.dynamics, simulated.found, simulated.initial_states, strict=True)
    for record, dyn, found, x0 in rows:
        slopes = innovation_slopes(dyn, record, found, x0)
        residuals = found.at_zero - np.tensordot(x0, found.response, 1)
        parts.append(scores(residuals * weight, found.response * weight, slopes * weight))
    return parts


def _weights_and_states(
    problem: Problem, found: tuple[Innovations, ...], given_std: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """σ (n_y,) and x0 of every record that maximise the likelihood together.

    Each output of each record is compressed to a small triangle first, so that the iteration costs nothing.
    """
    triangles = [_triangles(f) for f in found]
    counts = observed_counts(problem.records)
    floor = SMALLEST_STD * _sizes(problem.records)
    weigh = problem.weigh & (counts > 0)
    std = np.where(weigh, np.maximum(_rms(triangles, counts), floor), given_std)
    states: tuple[np.ndarray, ...] = ()
    for _ in range(WEIGHT_ITERATIONS):
        states = tuple(_state_from(t, std) for t in triangles)
        squares = sum(_squares(t, x0) for t, x0 in zip(triangles, states, strict=True))
        before, rms = std, np.sqrt(squares / np.maximum(counts, 1))
        std = np.where(weigh, np.maximum(rms, floor), given_std)
        if np.all(np.abs(std - before) <= WEIGHT_TOLERANCE * std):
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


def _negative_log_likelihood(problem: Problem, simulated: Simulated) -> float:
    std = simulated.measurement_std
    counts = observed_counts(problem.records)
    squares = sum(
        np.sum((f.at_zero - np.tensordot(x0, f.response, 1)) ** 2, axis=0)
        for f, x0 in zip(simulated.found, simulated.initial_states, strict=True)
    )
    return float(np.sum(counts * np.log(2 * np.pi * std**2) + squares / std**2) / 2)
