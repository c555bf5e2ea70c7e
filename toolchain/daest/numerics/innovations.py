"""Innovations form of (47): predictor gains, constant or sample by sample, with exact derivatives.

The stationary covariance comes from the structured doubling algorithm, which still converges (linearly)
when a mode on the unit circle has almost no noise, where the Schur method breaks down. Derivatives of the
stationary covariance solve a discrete Lyapunov equation, by squaring (Smith).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MAX_DOUBLINGS = 60
DOUBLING_TOLERANCE = (
    1e-14  # change of P per doubling, relative to the standard deviations of its rows and columns
)
FORGOTTEN = 1e-12  # size of a power of the closed loop whose square adds nothing any more
SETTLED_TOLERANCE = 1e-13  # change per sample of a time-varying covariance below which its gain is kept


@dataclass(frozen=True)
class NoiseModel:
    """Φ (n, n), C (n_y, n), Q (n, n), R (n_y, n_y), cross covariance S12 (n, n_y) of (47).

    For derivatives every field has a leading axis of p directions; for models that change with time an
    axis of samples follows it.
    """

    Phi: np.ndarray
    C: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    S12: np.ndarray


@dataclass(frozen=True)
class Gains:
    """Predictor gain K (…, n, n_y), innovation covariance S (…, n_y, n_y), covariance P (…, n, n) of
    x[k|k-1].
    """

    K: np.ndarray
    S: np.ndarray
    P: np.ndarray


def stationary_gains(noise: NoiseModel) -> Gains | None:
    """P = Φ P Φᵀ + Q - K S Kᵀ reached from P = 0, with its gain; None when R is singular or P does not
    settle.
    """
    try:
        P = _doubling(noise)
    except np.linalg.LinAlgError:
        return None
    if P is None:
        return None
    K, S = _gain(noise, P)
    return Gains(K, S, P)


def stationary_gain_derivatives(noise: NoiseModel, gains: Gains, change: NoiseModel) -> Gains | None:
    """Derivatives of `stationary_gains` in p directions; None when the closed loop does not settle."""
    closed = noise.Phi - gains.K @ noise.C
    still = np.zeros_like(change.Phi)
    _, _, forcing = _step_derivatives(noise, gains, change, still)
    dP = _lyapunov(closed, forcing)
    if dP is None:
        return None
    dK, dS, _ = _step_derivatives(noise, gains, change, dP)
    return Gains(dK, dS, dP)


def varying_gains(
    noise: NoiseModel,
    change: NoiseModel,
    observed: np.ndarray,
    P0: np.ndarray,
    dP0: np.ndarray,
    is_constant: bool,
) -> tuple[Gains, Gains]:
    """Gains for every sample, and their derivatives, of the time-varying Kalman filter that starts with
    P0.

    `observed` (n_samples, n_y): a missing output gets a zero gain and a unit innovation variance, so that
    it adds nothing to the likelihood. Φ, Q, S12 have an axis of n_samples - 1 steps unless `is_constant`;
    C and R are constant. Returns arrays with leading axes (n_samples,) and (p, n_samples).
    """
    n_samples, (p, n, _), n_y = observed.shape[0], change.Phi.shape[:1] + P0.shape, observed.shape[1]
    value = Gains(*(np.zeros((n_samples, *shape)) for shape in ((n, n_y), (n_y, n_y), (n, n))))
    slope = Gains(*(np.zeros((p, n_samples, *shape)) for shape in ((n, n_y), (n_y, n_y), (n, n))))
    P, dP, settled = P0, dP0, False
    for k in range(n_samples):
        if settled and np.all(observed[k]):
            for target in (value, slope):
                for array in (target.K, target.S, target.P):
                    np.moveaxis(array, -3, 0)[k] = np.moveaxis(array, -3, 0)[k - 1]
            continue
        step = k if is_constant else min(k, n_samples - 2)
        now, d_now = (
            _at_sample(noise, observed[k], step, is_constant),
            _at_sample(change, observed[k], step, is_constant),
        )
        now.R[~observed[k], ~observed[k]] = 1.0
        K, S = _gain(now, P)
        dK, dS, following_dP = _step_derivatives(now, Gains(K, S, P), d_now, dP)
        value.K[k], value.S[k], value.P[k] = K, S, P
        slope.K[:, k], slope.S[:, k], slope.P[:, k] = dK, dS, dP
        following = now.Phi @ P @ now.Phi.T + now.Q - K @ S @ K.T
        following = (following + following.T) / 2
        settled = is_constant and bool(np.all(observed[k])) and _is_settled(P, following, dP, following_dP)
        P, dP = following, following_dP
    return value, slope


def _at_sample(noise: NoiseModel, seen: np.ndarray, k: int, is_constant: bool) -> NoiseModel:
    """The model of one sample, with the rows of missing outputs cleared."""
    dynamic = (noise.Phi, noise.Q, noise.S12)
    Phi, Q, S12 = dynamic if is_constant else tuple(array[..., k, :, :] for array in dynamic)
    if np.all(seen):
        return NoiseModel(Phi, noise.C, Q, noise.R, S12)
    keep = seen.astype(float)
    return NoiseModel(Phi, noise.C * keep[:, None], Q, noise.R * np.outer(keep, keep), S12 * keep)


def _gain(noise: NoiseModel, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    PC = P @ noise.C.T
    S = noise.C @ PC + noise.R
    S = (S + S.T) / 2
    return np.linalg.solve(S, (noise.Phi @ PC + noise.S12).T).T, S


def _step_derivatives(
    noise: NoiseModel, gains: Gains, change: NoiseModel, dP: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives of K, S and of the next P when P itself changes by dP."""
    K, S, P = gains.K, gains.S, gains.P
    Phi, C = noise.Phi, noise.C
    PC = P @ C.T
    dPC = dP @ C.T + P @ _t(change.C)
    dS = change.C @ PC + C @ dPC + change.R
    numerator = change.Phi @ PC + Phi @ dPC + change.S12
    dK = _t(np.linalg.solve(S, _t(numerator - K @ dS)))
    half = change.Phi @ P @ Phi.T - numerator @ K.T
    following = half + _t(half) + Phi @ dP @ Phi.T + change.Q + K @ dS @ K.T
    return dK, dS, following


def _doubling(noise: NoiseModel) -> np.ndarray | None:
    """Structured doubling: after i steps P is the covariance after 2^i samples from P = 0."""
    weighted = np.linalg.solve(noise.R, np.hstack([noise.C, noise.S12.T]))
    n = noise.Phi.shape[0]
    A = (noise.Phi - noise.S12 @ weighted[:, :n]).T
    G = noise.C.T @ weighted[:, :n]
    P = noise.Q - noise.S12 @ weighted[:, n:]
    for _ in range(MAX_DOUBLINGS):
        W = np.linalg.solve(np.eye(n) + G @ P, np.hstack([A, G]))
        change = A.T @ P @ W[:, :n]
        G = G + A @ W[:, n:] @ A.T
        A = A @ W[:, :n]
        P = P + change
        P, G = (P + P.T) / 2, (G + G.T) / 2
        if not np.all(np.isfinite(P)):
            return None
        size = np.sqrt(np.maximum(np.diagonal(P), 0.0))
        if np.all(np.abs(change) <= DOUBLING_TOLERANCE * np.outer(size, size)):
            return P
    return P


def _lyapunov(closed: np.ndarray, forcing: np.ndarray) -> np.ndarray | None:
    """X = F X Fᵀ + M for every M (p, n, n), by squaring; None when the sum does not settle."""
    X, power = forcing, closed
    for _ in range(MAX_DOUBLINGS):
        change = power @ X @ power.T
        if not np.all(np.isfinite(change)):
            return None
        X = X + change
        power = power @ power
        if np.max(np.abs(power), initial=0.0) < FORGOTTEN or not np.any(change):
            return X
    return None


def _is_settled(P: np.ndarray, after: np.ndarray, dP: np.ndarray, d_after: np.ndarray) -> bool:
    size = np.sqrt(np.maximum(np.diagonal(after), 0.0))
    limit = SETTLED_TOLERANCE * np.outer(size, size)
    if np.any(np.abs(after - P) > limit):
        return False
    scale = np.max(np.abs(d_after), axis=(1, 2), initial=0.0)[:, None, None] * SETTLED_TOLERANCE
    return bool(np.all(np.abs(d_after - dP) <= limit + scale))


def _t(matrix: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrix, -1, -2)
