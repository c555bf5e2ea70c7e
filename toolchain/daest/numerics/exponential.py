"""Matrix exponential, its integrals and their exact derivatives: what sampling a linear model needs.

Integrals come from exponentials of block matrices (Van Loan 1978). The covariance integral is formed over
a short step and doubled, because e^(-A t), which Van Loan's block holds, overflows for stiff models over
long periods. Derivatives use L(M, dM), the upper right block of exp([[M, dM], [0, M]]), which is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

SHORT_STEP_NORM = 0.5  # ‖A h‖₁ up to which Van Loan's block is evaluated directly, before doubling


@dataclass(frozen=True)
class TransitionIntegrals:
    """Φ = e^(A T), first = ∫₀ᵀ e^(A s) ds and second = ∫₀ᵀ e^(A (T-s)) s ds / T; each (..., n, n)."""

    transition: np.ndarray
    first: np.ndarray
    second: np.ndarray


def transition_integrals(A: np.ndarray, period: float) -> TransitionIntegrals:
    """Φ and its two integrals over `period` [s] for A (n, n) [1/s]."""
    return _unpack(expm(_augmented(A * period)), A.shape[0], period)


def transition_integral_derivatives(A: np.ndarray, dA: np.ndarray, period: float) -> TransitionIntegrals:
    """Derivatives of `transition_integrals` in the directions dA (p, n, n); every field is (p, n, n)."""
    n = A.shape[0]
    direction = np.zeros((dA.shape[0], 3 * n, 3 * n))
    direction[:, :n, :n] = dA * period
    return _unpack(_frechet(_augmented(A * period), direction), n, period)


def covariance_integral(A: np.ndarray, Q: np.ndarray, period: float) -> np.ndarray:
    """∫₀ᵀ e^(A s) Q e^(Aᵀ s) ds for A (n, n) and symmetric Q (n, n)."""
    n = A.shape[0]
    doublings, step = _doublings(A, period)
    block = expm(_van_loan(A, Q, step))
    transition = block[n:, n:].T
    covariance = transition @ block[:n, n:]
    for _ in range(doublings):
        covariance = covariance + transition @ covariance @ transition.T
        transition = transition @ transition
    return (covariance + covariance.T) / 2


def covariance_integral_derivatives(
    A: np.ndarray, Q: np.ndarray, dA: np.ndarray, dQ: np.ndarray, period: float
) -> np.ndarray:
    """Derivatives (p, n, n) of `covariance_integral` in the directions (dA, dQ), both (p, n, n)."""
    n = A.shape[0]
    doublings, step = _doublings(A, period)
    base = _van_loan(A, Q, step)
    block, dblock = expm(base), _frechet(base, _van_loan(dA, dQ, step))
    transition, dtransition = block[n:, n:].T, _transposed(dblock[:, n:, n:])
    covariance = transition @ block[:n, n:]
    dcovariance = dtransition @ block[:n, n:] + transition @ dblock[:, :n, n:]
    for _ in range(doublings):
        half = dtransition @ covariance @ transition.T
        dcovariance = dcovariance + half + _transposed(half) + transition @ dcovariance @ transition.T
        covariance = covariance + transition @ covariance @ transition.T
        dtransition = dtransition @ transition + transition @ dtransition
        transition = transition @ transition
    return (dcovariance + _transposed(dcovariance)) / 2


def _augmented(At: np.ndarray) -> np.ndarray:
    """[[A T, I, 0], [0, 0, I], [0, 0, 0]]: its exponential holds Φ and both integrals divided by T."""
    n = At.shape[0]
    block = np.zeros((3 * n, 3 * n))
    block[:n, :n] = At
    block[:n, n : 2 * n] = np.eye(n)
    block[n : 2 * n, 2 * n :] = np.eye(n)
    return block


def _unpack(block: np.ndarray, n: int, period: float) -> TransitionIntegrals:
    first, second = block[..., :n, n : 2 * n], block[..., :n, 2 * n :]
    return TransitionIntegrals(block[..., :n, :n], period * first, period * second)


def _van_loan(A: np.ndarray, Q: np.ndarray, step: float) -> np.ndarray:
    """[[-A, Q], [0, Aᵀ]] h, for one or many (A, Q)."""
    n = A.shape[-1]
    block = np.zeros((*A.shape[:-2], 2 * n, 2 * n))
    block[..., :n, :n] = -A * step
    block[..., :n, n:] = Q * step
    block[..., n:, n:] = _transposed(A) * step
    return block


def _doublings(A: np.ndarray, period: float) -> tuple[int, float]:
    """Number of doublings, and the short step [s] that they start from."""
    norm = float(np.linalg.norm(A, 1)) * period if A.size else 0.0
    doublings = max(0, int(np.ceil(np.log2(norm / SHORT_STEP_NORM)))) if norm > SHORT_STEP_NORM else 0
    return doublings, period / 2**doublings


def _frechet(M: np.ndarray, dM: np.ndarray) -> np.ndarray:
    """L(M, dM) for every direction dM (p, m, m). Zero directions cost nothing."""
    p, m = dM.shape[0], M.shape[0]
    result = np.zeros((p, m, m))
    active = np.flatnonzero(np.any(dM != 0.0, axis=(1, 2)))
    if active.size:
        # L is linear in dM: directions are brought to the size of M, so that scaling does not depend on
        # units.
        size = np.linalg.norm(dM[active], axis=(1, 2)) / (np.linalg.norm(M) or 1.0)
        block = np.zeros((active.size, 2 * m, 2 * m))
        block[:, :m, :m] = M
        block[:, m:, m:] = M
        block[:, :m, m:] = dM[active] / size[:, None, None]
        result[active] = expm(block)[:, :m, m:] * size[:, None, None]
    return result


def _transposed(matrix: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrix, -1, -2)
