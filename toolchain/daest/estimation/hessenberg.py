"""States in which Φ is upper Hessenberg, where a step of the Kalman filter costs a third.

The likelihood does not depend on the states that it is written in. With x = D Z ξ, D diagonal and Z
orthogonal, Z' D⁻¹ Φ D Z has zeros below the entry before the diagonal (Golub & Van Loan, Matrix Computations,
4th edition, 7.4), and the product Φ P Φᵀ takes n³ operations in place of 3 n³. D holds standard deviations of
the states, so that Z mixes numbers of one size and rounding stays as small as it was.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import hessenberg

from daest.estimation.gates import FIT
from daest.model.estimates import Modes

LEAST_STATES, LEAST_SAMPLES = 16, 100  # below, the change of states takes longer than it saves
DOUBLINGS = 5  # the states move for 2^5 samples to find their sizes


def hessenberg_states(modes: Modes, cov: np.ndarray, n_samples: int) -> tuple[np.ndarray, np.ndarray] | None:
    """T (n, n) of x = T ξ, and T⁻¹, for a pass that begins with covariance `cov` (n, n) of x[0].

    None where it would not pay: few states or samples, several sampled models; where noises of states and
    outputs are correlated; and where the first sample tells so much that rounding would show (outputs without
    noise, a start that is next to unknown), for which there are steps in the states as they are.
    """
    n = cov.shape[0]
    is_small = n < LEAST_STATES or n_samples < LEAST_SAMPLES
    if is_small or np.unique(modes.model).size > 1 or np.any(modes.cross_cov):
        return None
    C, R = modes.output, modes.measurement_cov
    try:
        np.linalg.cholesky(R)
        told = np.trace(np.linalg.solve(R, C @ cov @ np.swapaxes(C, 1, 2)), axis1=1, axis2=2)
    except np.linalg.LinAlgError:
        return None
    size = _sizes(modes.transition[0], cov + modes.process_cov[0])
    if size is None or not np.max(told) <= FIT.hessenberg_start:
        return None
    _, Z = hessenberg(modes.transition[0] * size / size[:, None], calc_q=True, check_finite=False)
    return size[:, None] * Z, Z.T / size


def in_states(modes: Modes, T: np.ndarray, inverse: np.ndarray) -> Modes:
    """The matrices in the states ξ of `hessenberg_states`, for one model; x = T ξ, shapes (n, n)."""
    shape = modes.transition.shape
    H = np.triu(inverse @ modes.transition[0] @ T, -1)
    Q = inverse @ modes.process_cov[0] @ inverse.T
    return replace(
        modes,
        transition=np.broadcast_to(H, shape),
        process_cov=np.broadcast_to((Q + Q.T) / 2, shape),
        output=modes.output @ T,
        noise_process_cov=modes.noise_process_cov @ inverse.T,
    )


def _sizes(Phi: np.ndarray, Q: np.ndarray) -> np.ndarray | None:
    """Standard deviations (n,) of the states after some samples, as powers of two; None where they grow
    beyond all numbers."""
    for _ in range(DOUBLINGS):
        Q, Phi = Q + Phi @ Q @ Phi.T, Phi @ Phi
    variance = np.diagonal(Q)
    if not np.all(np.isfinite(variance)):
        return None
    return np.asarray(2.0 ** np.round(np.log2(np.where(variance > 0, variance, 1.0)) / 2))
