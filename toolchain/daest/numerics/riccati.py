"""Stationary covariances of a filter, and the innovations form of (47): predictor gains, constant or sample
by sample, with exact derivatives.

The filter Riccati equation is solved by Schur vectors or by structured doubling, which still converges
(linearly) when a mode on the unit circle has almost no noise, where the Schur method breaks down. Derivatives
of the stationary covariance solve a discrete Lyapunov equation, by squaring (Smith).

No output sees some parts of a state, such as the absolute angle of a machine that measures speeds. A hidden
mode that does not die out has no stationary covariance, yet it reaches no prediction. With the projection Π
on the unobservable subspace, Φ (I - Π) forgets that part at every step: the innovations and their covariances
stay what they are, gains change along hidden directions only, and every covariance settles.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import wraps
from hashlib import blake2b
from typing import TypeVar

import numpy as np
import scipy.linalg
from scipy.linalg.lapack import dgetrf, dgetrs

from daest.numerics.exponential import balanced
from daest.numerics.kalman_pass import StepMatrices, kalman_steps
from daest.numerics.recursions import GainChange

RESIDUAL_TOLERANCE = 1e-8  # of a Riccati solution, relative to the size of its terms
STABILITY_MARGIN = 1e-12  # a closed loop with a pole beyond 1 - this does not forget its start
DOUBLINGS = 60  # rounds; 2^60 steps of the recursion
REFINEMENTS = 3  # Newton steps after the Schur solution
Result = TypeVar("Result")
REMEMBERED_ROWS = (
    100  # of the first argument from which on results are kept: below, computing costs as little, ...
)
FEWEST_ROWS = 2  # ... but for what a search over noise levels asks for again and again
REMEMBERED_RESULTS = 4  # of each function


def remembered(
    fewest_rows: int,
) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """The function of arrays, with its latest results where the first one has at least so many rows; callers
    do not write into them."""

    def remembering(function: Callable[..., Result]) -> Callable[..., Result]:
        known: OrderedDict[bytes, Result] = OrderedDict()

        @wraps(function)
        def asked(*arrays: np.ndarray) -> Result:
            if arrays[0].shape[0] < fewest_rows:
                return function(*arrays)
            key = _digest(arrays)
            if key not in known:
                known[key] = function(*arrays)
                while len(known) > REMEMBERED_RESULTS:
                    known.popitem(last=False)
            return known[key]

        return asked

    return remembering


def _digest(arrays: tuple[np.ndarray, ...]) -> bytes:
    code = blake2b(digest_size=16)
    for array in arrays:
        code.update(str(array.shape).encode())
        code.update(np.ascontiguousarray(array).data)
    return code.digest()


@remembered(REMEMBERED_ROWS)
def filter_riccati(
    Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> np.ndarray | None:
    """Stabilising P = Φ P Φᵀ + Q - K (C P Cᵀ + R) Kᵀ with K = (Φ P Cᵀ + S12)(C P Cᵀ + R)⁻¹, shape (n, n).

    Doubling from P = 0 (2^i steps of the recursion after i rounds; accurate with poles close to the unit
    circle), once more in units of its own where it is not accurate enough; where it cannot be used or does
    not stabilise (R singular, an unstable mode without noise) the Schur method with Newton steps. None when
    neither gives a stabilising solution to RESIDUAL_TOLERANCE: there is an undetectable mode, or one on the
    unit circle without noise.

    States that no noise reaches and that die out are known in the end: their rows of P are zero. A method
    leaves rounding there, and no tolerance relative to such rows would pass it.
    """
    driven = _driven(Phi, Q)
    if driven.all() or not is_stable(Phi[np.ix_(~driven, ~driven)]):
        return _driven_covariance(Phi, C, Q, R, S12)
    inside, P = np.ix_(driven, driven), np.zeros_like(Phi)
    known = _driven_covariance(Phi[inside], C[:, driven], Q[inside], R, S12[driven])
    if known is None:
        return None
    P[inside] = known
    return P


def _driven(Phi: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Which states the noise of covariance Q (n, n) reaches through entries of Φ (n, n), (n,) bool."""
    feeds, driven = Phi != 0.0, np.any(Q != 0.0, axis=1)
    for _ in range(driven.size):
        driven = driven | feeds[:, driven].any(axis=1)
    return driven


def _driven_covariance(
    Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> np.ndarray | None:
    """`filter_riccati` of the states that noise drives."""
    if Phi.shape[0] == 0:
        return np.zeros((0, 0))
    # A diverging solution is dropped. Next to no noise on an integrator leaves a closed-loop pole next to the
    # unit circle: scipy warns of the Lyapunov equation then, but what counts is the residual.
    with np.errstate(over="ignore", invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", scipy.linalg.LinAlgWarning)
        found = _solutions(Phi, C, Q, R, S12)
        return next((P for P in found if P is not None and _solves(P, Phi, C, Q, R, S12)), None)


def _solutions(
    Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> Iterator[np.ndarray | None]:
    """What the methods find, one after the other; None where one cannot be used."""
    P = _doubled(Phi, C, Q, R, S12)
    yield P
    if P is not None:
        yield _doubled_in_units_of(P, Phi, C, Q, R, S12)
    if not _keeps_a_mode(Phi, Q):
        yield _schur(Phi, C, Q, R, S12)


def _keeps_a_mode(Phi: np.ndarray, Q: np.ndarray) -> bool:
    """Whether a mode on the unit circle has no noise: every solution leaves it in the closed loop."""

    def on_circle(values: np.ndarray) -> bool:
        return bool(np.any(np.abs(np.abs(values) - 1.0) <= STABILITY_MARGIN))

    if not np.isfinite(Phi).all() or not on_circle(np.linalg.eigvals(Phi)):
        return False
    _, unreached = unobservable_subspace(Phi.T, Q)
    return on_circle(undamped_modes(Phi.T, unreached, STABILITY_MARGIN)[0])


def predictor_gain(
    P: np.ndarray, Phi: np.ndarray, C: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """K = (Φ P Cᵀ + S12) S⁻¹ and S = C P Cᵀ + R; leading axes are broadcast. Shapes: P and Phi (..., n, n), C
    (..., n_y, n), R and S (..., n_y, n_y), S12 and K (..., n, n_y)."""
    PC = P @ np.swapaxes(C, -1, -2)
    S = C @ PC + R
    K = np.linalg.solve(S, np.swapaxes(Phi @ PC + S12, -1, -2))
    return np.swapaxes(K, -1, -2), S


@remembered(REMEMBERED_ROWS)
def is_stable(F: np.ndarray) -> bool:
    """Whether all eigenvalues of a transition matrix lie within the unit circle, by `STABILITY_MARGIN`.
    Shapes: F (n, n)."""
    return F.size == 0 or float(np.max(np.abs(np.linalg.eigvals(F)))) < 1.0 - STABILITY_MARGIN


@remembered(FEWEST_ROWS)
def unobservable_subspace(Phi: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Observable row space (r, n) and unobservable subspace (n, n - r) of (C, Φ), in units of the states.

    A staircase on Φ - I (the same subspaces, but not nearly dependent when the sampling is fast) after
    diagonal balancing: new directions (Φ - I)ᵀ V count while their size exceeds the rounding error of Φ,
    tolerance 100 n eps (1 + ||Φ||); those of C itself are exact. The rows and columns are orthonormal after
    balancing only.
    """
    n = Phi.shape[0]
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, 0))
    step, size = balanced(Phi - np.eye(n))
    tolerance = rounding = 100 * n * np.finfo(float).eps
    rows = C * size  # x = size · balanced
    lengths = np.linalg.norm(rows, axis=1)
    rows = rows[lengths > 0] / lengths[lengths > 0, None]
    basis = np.zeros((0, n))
    while rows.shape[0] and basis.shape[0] < n:
        for _ in range(2):  # twice is enough against rounding
            rows = rows - (rows @ basis.T) @ basis
        _, values, directions = np.linalg.svd(rows, full_matrices=False)
        new = directions[values > tolerance]
        basis = np.vstack([basis, new])
        rows, tolerance = new @ step, rounding * (1.0 + np.linalg.norm(step + np.eye(n), 2))
    null = scipy.linalg.null_space(basis) if basis.shape[0] else np.eye(n)
    return basis / size, size[:, None] * null[:, : n - basis.shape[0]]


def undamped_modes(Phi: np.ndarray, subspace: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues with |λ| > 1 - margin and eigenvectors (n, m) of Φ inside an invariant subspace (n, r)."""
    if subspace.shape[1] == 0:
        return np.zeros(0), np.zeros((Phi.shape[0], 0))
    inner = np.linalg.lstsq(subspace, Phi @ subspace, rcond=None)[0]
    values, vectors = np.linalg.eig(inner)
    keep = np.abs(values) > 1.0 - margin
    return values[keep], (subspace @ vectors)[:, keep]


def _doubled(
    Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> np.ndarray | None:
    """Structure-preserving doubling (Chu, Fan, Lin & Wang 2004) for the filter equation without cross
    covariance, to which Φ - S12 R⁻¹ C and Q - S12 R⁻¹ S12ᵀ reduce it."""
    try:
        root = np.linalg.inv(np.linalg.cholesky(R))
    except np.linalg.LinAlgError:
        return None
    C, S12 = root @ C, S12 @ root.T
    A, G, H = (Phi - S12 @ C).T, C.T @ C, Q - S12 @ S12.T
    eye, eps = np.eye(A.shape[0]), np.finfo(float).eps
    for _ in range(DOUBLINGS):
        W = eye + G @ H
        factors, pivots, status = dgetrf(W)
        if status:
            return None
        forward = dgetrs(factors, pivots, A)[0]
        backward = dgetrs(factors, pivots, A.T, trans=1)[0].T
        change = forward.T @ H @ A
        G = G + backward @ G @ A.T
        A, G, H = A @ forward, (G + G.T) / 2, H + (change + change.T) / 2
        if not np.isfinite(H).all() or not np.isfinite(A).all():
            return None
        size = np.sqrt(np.abs(H.diagonal()))
        if (np.abs(change) <= eps * (size[:, None] * size)).all():
            return H
    return None


def _doubled_in_units_of(
    P: np.ndarray, Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> np.ndarray | None:
    """`_doubled` for states in units of the standard deviations that it has found, of a covariance P: beside
    pressures in pascals, the pivots of its equations lose what a flow in m3/s that hardly any noise drives
    has in common with them."""
    variances = P.diagonal()
    exponents = np.round(0.5 * np.log2(variances, where=variances > 0.0, out=np.zeros_like(variances)))
    size = np.exp2(exponents)
    units = size[:, None] * size
    scaled = _doubled(Phi * size / size[:, None], C * size, Q / units, R, S12 / size[:, None])
    return None if scaled is None else scaled * units


def _schur(
    Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> np.ndarray | None:
    """Solution from the Schur vectors of the extended pencil; each Newton step is a Lyapunov equation. None
    where there is none, or where what the vectors give is no covariance: it may leave C P Cᵀ + R singular."""
    try:
        P = scipy.linalg.solve_discrete_are(Phi.T, C.T, Q, R, s=S12)
        for _ in range(REFINEMENTS):
            P = _newton(P, Phi, C, Q, R, S12)
            if P is None:
                return None
    except (np.linalg.LinAlgError, ValueError):
        return None
    return P


def _newton(
    P: np.ndarray, Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> np.ndarray | None:
    K, _ = predictor_gain(P, Phi, C, R, S12)
    F = Phi - K @ C
    if not is_stable(F):
        return None
    cross = K @ S12.T
    P = scipy.linalg.solve_discrete_lyapunov(F, Q - cross - cross.T + K @ R @ K.T)
    return (P + P.T) / 2


def _solves(
    P: np.ndarray, Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> bool:
    K, S = predictor_gain(P, Phi, C, R, S12)
    residual = Phi @ P @ Phi.T + Q - K @ S @ K.T - P
    size = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    limit = RESIDUAL_TOLERANCE * (np.abs(Phi) @ np.abs(P) @ np.abs(Phi).T + np.abs(Q) + np.outer(size, size))
    return bool(np.all(np.isfinite(P)) and np.all(np.abs(residual) <= limit) and is_stable(Phi - K @ C))


MAX_DOUBLINGS = 60
DOUBLING_TOLERANCE = (
    1e-14  # change of P per doubling, relative to the standard deviations of its rows and columns
)
FORGOTTEN = 1e-12  # size of a power of the closed loop whose square adds nothing any more


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
    noise: NoiseModel, change: NoiseModel, observed: np.ndarray, P0: np.ndarray, dP0: np.ndarray
) -> tuple[Gains, Gains]:
    """Gains for every sample, and their derivatives, of the time-varying Kalman filter that starts with P0.

    `observed` (n_samples, n_y): a missing output gets a zero gain and a unit innovation variance, so that it
    adds nothing to the likelihood. Φ, Q, S12 are constant or have an axis of n_samples - 1 steps; C and R are
    constant. Returns arrays with leading axes (n_samples,) and (p, n_samples).

    For a given gain the change of P obeys dP[k+1] = F dP[k] Fᵀ + M[k], F = Φ - K C, since P is stationary in
    K; only this recursion and that of P itself go sample by sample.
    """
    value = _varying_values(noise, observed, P0)
    if not len(dP0):  # values alone are asked for
        return value, Gains(*(np.zeros((0, *part.shape)) for part in (value.K, value.S, value.P)))
    matrices = (noise.Phi, noise.C, change.Phi, change.C, change.Q, change.R, change.S12)
    found = GainChange(*matrices, observed, value.K, value.S, value.P, dP0).compiled()
    return value, Gains(*found) if found is not None else _varying_slopes(noise, change, observed, value, dP0)


def _varying_slopes(
    noise: NoiseModel, change: NoiseModel, observed: np.ndarray, value: Gains, dP0: np.ndarray
) -> Gains:
    """The derivatives of `varying_gains` sample by sample."""
    n_samples, n = observed.shape[0], dP0.shape[1]
    now, d_now = _per_sample(noise, observed, 0), _per_sample(change, observed, 1)
    K, P = value.K, value.P
    closed = now.Phi - K @ now.C
    half = (d_now.Phi - K @ d_now.C) @ P @ _t(closed) - d_now.S12 @ _t(K)
    forcing = half + _t(half) + d_now.Q + K @ d_now.R @ _t(K)
    dP = np.empty((n_samples, change.Phi.shape[0], n, n))
    dP[0] = dP0
    steps = np.ascontiguousarray(np.swapaxes(forcing, 0, 1))
    for k in range(n_samples - 1):
        dP[k + 1] = closed[k] @ dP[k] @ closed[k].T + steps[k]
    dP = np.swapaxes(dP, 0, 1)
    dPC = dP @ _t(now.C) + P @ _t(d_now.C)
    dS = d_now.C @ P @ _t(now.C) + now.C @ dPC + d_now.R
    dK = d_now.Phi @ P @ _t(now.C) + now.Phi @ dPC + d_now.S12 - K @ dS
    return Gains(dK @ np.linalg.inv(value.S), dS, dP)


def _varying_values(noise: NoiseModel, observed: np.ndarray, P0: np.ndarray) -> Gains:
    """P, K and S sample by sample, by the step of the Kalman filter with all signals zero."""
    n_samples, n, n_y = observed.shape[0], P0.shape[0], observed.shape[1]
    varies = max(noise.Phi.ndim, noise.Q.ndim, noise.S12.ndim) > 2
    if varies:
        rows, mode = observed, np.arange(n_samples)
    else:
        rows, mode = np.unique(observed, axis=0, return_inverse=True)
    now = _per_sample(noise, rows, 0) if varies else _by_pattern(noise, rows)
    R = now.R + (~rows)[:, :, None] * np.eye(n_y)
    parts = (now.Phi, now.C, now.Q, now.S12, R, np.zeros((1, 0, 0)), np.zeros((1, 0, n_y)))
    matrices = StepMatrices(*(np.broadcast_to(part, (len(rows), *part.shape[1:])) for part in parts))
    signals = np.zeros((n_samples, n_y)), np.zeros((n_samples, n))
    found = kalman_steps(matrices, mode.ravel(), *signals, np.zeros((n, 1)), P0)
    assert found.cov is not None
    if found.failed is not None:  # the caller sees that the numbers are none
        return Gains(*(np.full((n_samples, *shape), np.nan) for shape in ((n, n_y), (n_y, n_y), (n, n))))
    return Gains(found.gain, found.innovation_cov, found.cov)


def _by_pattern(noise: NoiseModel, observed: np.ndarray) -> NoiseModel:
    """Constant matrices for every pattern (n_patterns, n_y) of observed outputs, rows of others cleared."""
    keep = observed.astype(float)
    return NoiseModel(
        noise.Phi[None],
        noise.C * keep[:, :, None],
        noise.Q[None],
        noise.R * keep[:, :, None] * keep[:, None, :],
        noise.S12 * keep[:, None, :],
    )


def _per_sample(noise: NoiseModel, observed: np.ndarray, lead: int) -> NoiseModel:
    """All samples at once, rows of missing outputs cleared; `lead` axes of directions come first.

    The last sample has no step: it repeats that of the sample before, and nothing depends on it.
    """
    keep = observed.astype(float)
    rows = np.minimum(np.arange(observed.shape[0]), observed.shape[0] - 2)

    def spread(array: np.ndarray) -> np.ndarray:
        return array[..., None, :, :] if array.ndim == 2 + lead else array[..., rows, :, :]

    pairs = keep[:, :, None] * keep[:, None, :]
    return NoiseModel(
        spread(noise.Phi),
        noise.C[..., None, :, :] * keep[:, :, None],
        spread(noise.Q),
        noise.R[..., None, :, :] * pairs,
        spread(noise.S12) * keep[:, None, :],
    )


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
    eye, both = np.eye(n), np.empty((n, 2 * n))
    for _ in range(MAX_DOUBLINGS):
        both[:, :n], both[:, n:] = A, G
        W = np.linalg.solve(eye + G @ P, both)
        change = A.T @ P @ W[:, :n]
        G = G + A @ W[:, n:] @ A.T
        A = A @ W[:, :n]
        P = P + change
        P, G = (P + P.T) / 2, (G + G.T) / 2
        if not np.isfinite(P).all():
            return None
        size = np.sqrt(np.maximum(P.diagonal(), 0.0))
        if (np.abs(change) <= DOUBLING_TOLERANCE * (size[:, None] * size)).all():
            return P
    return P


def _lyapunov(closed: np.ndarray, forcing: np.ndarray) -> np.ndarray | None:
    """X = F X Fᵀ + M for every M (p, n, n), by squaring; None when the sum does not settle."""
    X, power = forcing, closed
    for _ in range(MAX_DOUBLINGS):
        change = power @ X @ power.T
        if not np.isfinite(change).all():
            return None
        X = X + change
        power = power @ power
        if np.abs(power).max(initial=0.0) < FORGOTTEN or not change.any():
            return X
    return None


def _t(matrix: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrix, -1, -2)


UNDAMPED_MARGIN = 1e-9  # a mode with |λ| > 1 - this does not die out within a record


def hidden_basis(Phi: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Unobservable subspace (n, r) of (C, Φ), empty (n, 0) unless it holds a mode that does not die out, and
    where no output sees anything at all."""
    if not np.all(np.isfinite(Phi)) or not np.any(C):
        return np.zeros((Phi.shape[0], 0))
    if np.max(np.abs(np.linalg.eigvals(Phi)), initial=0.0) <= 1.0 - UNDAMPED_MARGIN:
        return np.zeros((Phi.shape[0], 0))
    _, hidden = unobservable_subspace(Phi, C)
    return hidden if undamped_modes(Phi, hidden, UNDAMPED_MARGIN)[0].size else hidden[:, :0]


def forgetting(Phi: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Φ (I - Π) for a transition Φ (n, n): the same predictions without the undamped hidden modes."""
    basis = hidden_basis(Phi, C)
    return Phi - Phi @ _Projection(Phi, basis).whole if basis.shape[1] else Phi


def forgetting_model(noise: NoiseModel, change: NoiseModel | None) -> tuple[NoiseModel, NoiseModel | None]:
    """`noise` with Φ (I - Π) in place of Φ, and its derivatives in p directions.

    Φ (…, n, n) may have an axis of steps: all are functions of one matrix of rates and hide the same
    directions. Where these turn with a parameter, so does Π.
    """
    first = noise.Phi[(0,) * (noise.Phi.ndim - 2)]
    basis = hidden_basis(first, noise.C)
    if not basis.shape[1]:
        return noise, change
    onto = _Projection(first, basis)
    still = replace(noise, Phi=noise.Phi - noise.Phi @ onto.whole)
    if change is None:
        return still, None
    directions = change.Phi.reshape(change.Phi.shape[0], -1, *change.Phi.shape[-2:])[:, 0]
    turned = onto.turning(first, noise.C, directions, change.C)
    # The steps one below the other: one product for each direction instead of one for each step.
    p, n = turned.shape[:2]
    by_turning = (noise.Phi.reshape(-1, n) @ turned).reshape(p, *noise.Phi.shape)
    return still, replace(change, Phi=change.Phi - change.Phi @ onto.whole - by_turning)


class _Projection:
    """Π = N L on the columns of N (n, r), L N = I; orthogonal in the units that balance Φ."""

    def __init__(self, Phi: np.ndarray, basis: np.ndarray) -> None:
        self._size = balanced(Phi - np.eye(Phi.shape[0]))[1]
        self._columns = np.linalg.qr(basis / self._size[:, None])[0]
        self._back = self._columns.T / self._size
        self.whole = self._size[:, None] * self._columns @ self._back

    def turning(self, Phi: np.ndarray, C: np.ndarray, dPhi: np.ndarray, dC: np.ndarray) -> np.ndarray:
        """dΠ (p, n, n) = dN L. C N = 0 and Φ N = N Λ hold for every θ, so that C dN = -dC N and, outside of
        N, Φ dN - dN Λ = -dΦ N."""
        size, inside = self._size, self._columns
        outside = scipy.linalg.null_space(inside.T)
        (m, r), rate = (outside.shape[1], inside.shape[1]), Phi * size / size[:, None]
        sylvester = np.kron(np.eye(r), outside.T @ rate @ outside)
        sylvester -= np.kron((inside.T @ rate @ inside).T, np.eye(m))
        system = np.vstack([sylvester, np.kron(np.eye(r), C * size @ outside)])
        drift = outside.T @ (dPhi * size / size[:, None]) @ inside
        wanted = np.concatenate([_stacked(drift), _stacked(dC * size @ inside)], axis=1)
        found = np.linalg.lstsq(system, -wanted.T, rcond=None)[0].T.reshape(-1, r, m)
        return size[:, None] * (outside @ found.transpose(0, 2, 1)) @ self._back


def _stacked(matrices: np.ndarray) -> np.ndarray:
    """The columns of each of p matrices one below the other, (p, m r)."""
    return matrices.transpose(0, 2, 1).reshape(matrices.shape[0], -1)
