"""Initial states and scores: what the whitened residuals of the records say about x0 and about the
unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

INITIAL_RANK = 1e-8  # a combination of initial states whose response is this small, relative, stays at zero


@dataclass(frozen=True)
class Scores:
    """Of one record: whitened residuals (n_samples, n_y), whitened slopes (p, n_samples, n_y) with the part
    that the initial state explains removed, and covariance factors of x0.

    x0 = x0 at the estimate + initial_slope · δ + noise with covariance initial_cov, δ in the directions (p,).
    """

    residuals: np.ndarray
    slopes: np.ndarray
    initial_cov: np.ndarray  # (n, n), NaN rows where x0 is not determined
    initial_slope: np.ndarray  # (n, p)


def initial_state(responses: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """x0 (n,) that minimises |residuals - x0 · responses|; responses (n, m), residuals (m,), both
    whitened.

    Combinations with a response below INITIAL_RANK of the largest (after scaling each state) are left at
    zero.
    """
    scale = _scales(responses)
    return np.linalg.lstsq((responses / scale[:, None]).T, residuals, rcond=INITIAL_RANK)[0] / scale


def scores(residuals: np.ndarray, response: np.ndarray, slopes: np.ndarray) -> Scores:
    """Project whitened `slopes` (p, n_samples, n_y) on what no initial state explains; `response` is
    whitened.
    """
    n, p = response.shape[0], slopes.shape[0]
    A, J = response.reshape(n, residuals.size).T, slopes.reshape(p, residuals.size).T
    scale = _scales(A.T)
    left, values, right = np.linalg.svd(A / scale, full_matrices=False)
    kept = values > INITIAL_RANK * np.max(values, initial=0.0)
    left, values, right = left[:, kept], values[kept], right[kept]
    inside = left.T @ J
    pseudo = (right.T / values) / scale[:, None]
    cov = pseudo @ pseudo.T
    lost = np.sum(right**2, axis=0) < 1.0 - INITIAL_RANK
    cov[lost] = cov[:, lost] = np.nan
    return Scores(residuals, (J - left @ inside).T.reshape(slopes.shape), cov, pseudo @ inside)


def _scales(responses: np.ndarray) -> np.ndarray:
    sizes = np.linalg.norm(responses, axis=1)
    return np.where(sizes > 0.0, sizes, 1.0)
