"""Predicted outputs of a record for one θ, and their exact derivatives, by sensitivity recursions.

Output error and Kalman predictor are the same recursion, with and without the gain:
x̂[k+1] = Φ x̂[k] + Γ0 ū[k] + Γ1 ū[k+1] + γ + K ε[k],  ε[k] = y[k] - C x̂[k] - D ū[k] - d.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from daest.estimation.gates import FIT
from daest.estimation.records import Record
from daest.model.linear import StateSpace
from daest.numerics.innovations import (
    Gains,
    NoiseModel,
    forgetting_model,
    stationary_gain_derivatives,
    stationary_gains,
    varying_gains,
)
from daest.numerics.recursions import linear_recursion
from daest.systems.sample import Hold, Noise, SampledDerivatives, sample, sample_derivatives

MAX_DISTINCT_STEPS = 24  # up to this many different steps are sampled one by one; more are interpolated
CHEBYSHEV_NODES = 20  # per octave of step lengths; e^(A h) is smooth in h, so the error is at rounding level


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
    """Sample `ss` for the steps of a record; with `derivatives` (p directions) also the slopes."""
    if record.period is not None or record.n_samples < 2:
        return _one_step(ss, record.period or 1.0, hold, noise, derivatives)
    steps = np.diff(record.time)
    rounded = np.rint(steps / (FIT.equal_periods * np.mean(steps))).astype(np.int64)
    _, first, which = np.unique(rounded, return_index=True, return_inverse=True)
    if first.size <= MAX_DISTINCT_STEPS:
        weights = np.eye(first.size)[which]
        nodes = steps[first]
    else:
        nodes, weights = _interpolation(steps)
    return _combined([_one_step(ss, float(h), hold, noise, derivatives) for h in nodes], weights)


def kalman_gains(dyn: Recursion, record: Record) -> tuple[Gains, Gains | None] | None:
    """Gains and their derivatives for a record; None when the covariance does not settle.

    The filter starts with the stationary covariance P, around a mean that is estimated. For complete
    uniform records it is then stationary from the first sample: nothing is approximated. Otherwise it is
    time-varying. Directions of the state that no output sees and that never settle are left out of P.
    """
    noise, change = forgetting_model(_noise_model(dyn), _noise_slope(dyn))
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


def innovations(dyn: Recursion, record: Record, gains: tuple[Gains, Gains | None] | None) -> Innovations:
    """Residuals for x0 = 0 and their response to every initial state."""
    K = None if gains is None else gains[0].K
    u, n = record.inputs, dyn.Phi.shape[-1]
    known = record.outputs - u @ dyn.D.T - dyn.d
    drive = _times(dyn.now, u[:-1]) + _times(dyn.following, u[1:]) + dyn.drift
    if K is not None:
        drive = drive + _times(_steps(K), known[:-1] * record.observed[:-1])
    drives = np.zeros((n + 1, record.n_samples - 1, n))
    drives[0] = drive
    starts = np.vstack([np.zeros((1, n)), np.eye(n)])
    states = _recursion(_closed(dyn, K), drives, starts)
    seen = record.observed
    slope = None if gains is None else gains[1]
    return Innovations(
        at_zero=(known - states[0] @ dyn.C.T) * seen,
        response=(states[1:] @ dyn.C.T) * seen,
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
    direct = states @ _t(slope.output) + u @ _t(slope.feedthrough) + slope.output_offset[:, None, :]
    drive = _times(slope.transition, states[:-1], 1) + _times(slope.input_now, u[:-1], 1)
    drive = drive + _times(slope.input_next, u[1:], 1)
    drive = drive + (slope.drift[:, None, :] if slope.drift.ndim == 2 else slope.drift)
    if found.K is not None and found.K_slope is not None:
        drive = drive + _times(_steps(found.K_slope, 1), eps[:-1], 1)
        drive = drive - _times(_steps(found.K), direct[:, :-1] * seen[:-1])
    start = np.zeros((drive.shape[0], drive.shape[2]))
    moved = _recursion(_closed(dyn, found.K), drive, start)
    return -(moved @ dyn.C.T + direct) * seen


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


def _interpolation(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev nodes of every octave of step lengths that occurs, and barycentric weights (n_steps,
    n_nodes).
    """
    shortest = float(np.min(steps))
    octave = np.floor(np.log2(steps / shortest) + 1e-12).astype(int)
    angles = np.pi * (2 * np.arange(CHEBYSHEV_NODES) + 1) / (2 * CHEBYSHEV_NODES)
    signs = (-1.0) ** np.arange(CHEBYSHEV_NODES) * np.sin(angles)
    nodes, blocks = [], np.zeros((steps.size, 0))
    for number in np.unique(octave):
        low = shortest * 2.0**number
        points = low * (1.5 + 0.5 * np.cos(angles))
        rows = octave == number
        distance = steps[rows, None] - points
        exact = distance == 0.0
        raw = signs / np.where(exact, 1.0, distance)
        raw[np.any(exact, axis=1)] = 0.0
        raw[exact] = 1.0
        block = np.zeros((steps.size, CHEBYSHEV_NODES))
        block[rows] = raw / raw.sum(axis=1, keepdims=True)
        nodes.append(points)
        blocks = np.hstack([blocks, block])
    return np.concatenate(nodes), blocks


def _noise_model(dyn: Recursion) -> NoiseModel:
    return NoiseModel(dyn.Phi, dyn.C, dyn.Q, dyn.R, dyn.S12)


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
    return rows @ _t(matrix) if matrix.ndim == 2 + lead else (matrix @ rows[..., None])[..., 0]


def _recursion(closed: np.ndarray, drive: np.ndarray, start: np.ndarray) -> np.ndarray:
    """States (m, n_samples, n) of m right-hand sides; `closed` (n, n) or one matrix per step."""
    if closed.ndim == 2:
        return linear_recursion(closed, drive, start)
    states = np.empty((drive.shape[0], drive.shape[1] + 1, drive.shape[2]))
    states[:, 0] = start
    for k in range(drive.shape[1]):
        states[:, k + 1] = states[:, k] @ closed[k].T + drive[:, k]
    return states


def _t(matrix: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrix, -1, -2)
