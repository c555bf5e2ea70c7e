"""Stationary covariances: the filter Riccati equation, and the modes that stand in its way."""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from hashlib import blake2b
from typing import TypeVar

import numpy as np
import scipy.linalg

from daest.numerics.exponential import balanced

RESIDUAL_TOLERANCE = 1e-8  # of a Riccati solution, relative to the size of its terms
STABILITY_MARGIN = 1e-12  # a closed loop with a pole beyond 1 - this does not forget its start
DOUBLINGS = 60  # rounds; 2^60 steps of the recursion
REFINEMENTS = 3  # Newton steps after the Schur solution
Result = TypeVar("Result")
REMEMBERED_ROWS = (
    100  # of the first argument from which on results are kept: below, computing costs as little
)
REMEMBERED_RESULTS = 4  # of each function


def remembered(function: Callable[..., Result]) -> Callable[..., Result]:
    """The function of arrays, with its latest results for large ones; callers do not write into them."""
    known: OrderedDict[bytes, Result] = OrderedDict()

    @wraps(function)
    def asked(*arrays: np.ndarray) -> Result:
        if arrays[0].shape[0] < REMEMBERED_ROWS:
            return function(*arrays)
        key = _digest(arrays)
        if key not in known:
            known[key] = function(*arrays)
            while len(known) > REMEMBERED_RESULTS:
                known.popitem(last=False)
        return known[key]

    return asked


def _digest(arrays: tuple[np.ndarray, ...]) -> bytes:
    code = blake2b(digest_size=16)
    for array in arrays:
        code.update(str(array.shape).encode())
        code.update(np.ascontiguousarray(array).data)
    return code.digest()


@remembered
def filter_riccati(
    Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> np.ndarray | None:
    """Stabilising P = Φ P Φᵀ + Q - K (C P Cᵀ + R) Kᵀ with K = (Φ P Cᵀ + S12)(C P Cᵀ + R)⁻¹, shape (n, n).

    Doubling from P = 0 (2^i steps of the recursion after i rounds; accurate with poles close to the unit
    circle and any units); where it cannot be used or does not stabilise (R singular, an unstable mode without
    noise) the Schur method with Newton steps. None when neither gives a stabilising solution to
    RESIDUAL_TOLERANCE: there is an undetectable mode, or one on the unit circle without noise.
    """
    if Phi.shape[0] == 0:
        return np.zeros((0, 0))
    for method in (_doubling, _schur):
        # A diverging solution is dropped below. Next to no noise on an integrator leaves a closed-loop pole
        # next to the unit circle: scipy warns of the Lyapunov equation then, but what counts is the residual.
        with np.errstate(over="ignore", invalid="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", scipy.linalg.LinAlgWarning)
            P = method(Phi, C, Q, R, S12)
        if P is not None and _solves(P, Phi, C, Q, R, S12):
            return P
    return None


def predictor_gain(
    P: np.ndarray, Phi: np.ndarray, C: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """K = (Φ P Cᵀ + S12) S⁻¹ and S = C P Cᵀ + R; leading axes are broadcast."""
    PC = P @ np.swapaxes(C, -1, -2)
    S = C @ PC + R
    K = np.linalg.solve(S, np.swapaxes(Phi @ PC + S12, -1, -2))
    return np.swapaxes(K, -1, -2), S


@remembered
def is_stable(F: np.ndarray) -> bool:
    """Whether all eigenvalues of a transition matrix lie within the unit circle, by `STABILITY_MARGIN`."""
    return F.size == 0 or float(np.max(np.abs(np.linalg.eigvals(F)))) < 1.0 - STABILITY_MARGIN


@remembered
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


def _doubling(
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
    for _ in range(DOUBLINGS):
        W = np.eye(A.shape[0]) + G @ H
        factors = scipy.linalg.lu_factor(W, check_finite=False)
        if np.any(np.diagonal(factors[0]) == 0.0):
            return None
        forward = scipy.linalg.lu_solve(factors, A, check_finite=False)
        backward = scipy.linalg.lu_solve(factors, A.T, trans=1, check_finite=False).T
        change = forward.T @ H @ A
        G = G + backward @ G @ A.T
        A, G, H = A @ forward, (G + G.T) / 2, H + (change + change.T) / 2
        if not np.all(np.isfinite(H)) or not np.all(np.isfinite(A)):
            return None
        size = np.sqrt(np.abs(np.diagonal(H)))
        if np.all(np.abs(change) <= np.finfo(float).eps * np.outer(size, size)):
            return H
    return None


def _schur(
    Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> np.ndarray | None:
    """Solution from the Schur vectors of the extended pencil; each Newton step is a Lyapunov equation."""
    try:
        P = scipy.linalg.solve_discrete_are(Phi.T, C.T, Q, R, s=S12)
    except (np.linalg.LinAlgError, ValueError):
        return None
    for _ in range(REFINEMENTS):
        P = _newton(P, Phi, C, Q, R, S12)
        if P is None:
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
