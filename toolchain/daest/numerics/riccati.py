"""Stationary covariances: the filter Riccati equation, and the modes that stand in its way."""

from __future__ import annotations

import numpy as np
import scipy.linalg

RESIDUAL_TOLERANCE = 1e-8  # of a Riccati solution, relative to the size of its terms
STABILITY_MARGIN = 1e-12  # a closed loop with a pole beyond 1 - this does not forget its start
REFINEMENTS = 3  # Newton steps after the Schur solution


def filter_riccati(
    Phi: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> np.ndarray | None:
    """Stabilising P = Φ P Φᵀ + Q - K (C P Cᵀ + R) Kᵀ with K = (Φ P Cᵀ + S12)(C P Cᵀ + R)⁻¹, shape (n, n).

    Schur method, then Newton steps (each a Lyapunov equation, so that P is positive semidefinite). None when there
    is no stabilising solution to RESIDUAL_TOLERANCE: an undetectable mode, or one on the unit circle without noise.
    """
    n = Phi.shape[0]
    if n == 0:
        return np.zeros((0, 0))
    try:
        P = scipy.linalg.solve_discrete_are(Phi.T, C.T, Q, R, s=S12)
        for _ in range(REFINEMENTS):
            P = _newton(P, Phi, C, Q, R, S12)
            if P is None:
                return None
        return P if _solves(P, Phi, C, Q, R, S12) else None
    except (np.linalg.LinAlgError, ValueError):
        return None


def predictor_gain(
    P: np.ndarray, Phi: np.ndarray, C: np.ndarray, R: np.ndarray, S12: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """K = (Φ P Cᵀ + S12) S⁻¹ and S = C P Cᵀ + R; leading axes are broadcast."""
    PC = P @ np.swapaxes(C, -1, -2)
    S = C @ PC + R
    K = np.linalg.solve(S, np.swapaxes(Phi @ PC + S12, -1, -2))
    return np.swapaxes(K, -1, -2), S


def is_stable(F: np.ndarray) -> bool:
    return F.size == 0 or float(np.max(np.abs(np.linalg.eigvals(F)))) < 1.0 - STABILITY_MARGIN


def unobservable_subspace(Phi: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Observable row space (r, n) and unobservable subspace (n, n - r) of (C, Φ), in units of the states.

    A staircase on Φ - I (the same subspaces, but not nearly dependent when the sampling is fast) after diagonal
    balancing: new directions (Φ - I)ᵀ V count while their size exceeds the rounding error of Φ, tolerance
    100 n eps (1 + ||Φ||). The rows and columns are orthonormal after balancing only.
    """
    n = Phi.shape[0]
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, 0))
    step, (size, _) = scipy.linalg.matrix_balance(Phi - np.eye(n), permute=False, separate=True)
    tolerance = 100 * n * np.finfo(float).eps * (1.0 + np.linalg.norm(step + np.eye(n), 2))
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
        rows = new @ step
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
