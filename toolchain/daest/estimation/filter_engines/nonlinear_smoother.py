"""Smoothers for the runs of the nonlinear Gaussian filters: states and process noise given the whole record.

Extended filter: Bryson and Frazier's recursion with the transitions of the filter, which inverts no state
covariance, so that noise-free states are allowed. Unscented filter: Rauch, Tung and Striebel's recursion with
the covariances between successive states (Särkkä, IEEE Trans. Automatic Control 2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daest.estimation.filter_engines.ekf import EkfRun
from daest.estimation.filter_engines.filter_task import Noise, Record
from daest.estimation.filter_engines.ukf import UkfRun
from daest.numerics.gaussian import backward_step, run

RANK_TOLERANCE = (
    1e-12  # of a predicted covariance scaled to unit variances: directions below count as certain
)


@dataclass(frozen=True)
class Joint:
    """Mean (n_samples, n + n_w) and covariance (n_samples, n + n_w, n + n_w) of the state at each sample and
    the mean of the process noise over the interval that follows it."""

    mean: np.ndarray
    cov: np.ndarray


def filtered_joint(data: Record, noise: Noise, filtered: np.ndarray, filtered_cov: np.ndarray) -> Joint:
    """What the past says: the noise to come is independent of it. The last interval counts twice. Shapes:
    filtered (n_samples, n), filtered_cov (n_samples, n, n)."""
    (samples, n), n_w = filtered.shape, noise.intensity.size
    steps = np.append(data.steps, data.steps[-1])
    cov = np.zeros((samples, n + n_w, n + n_w))
    cov[:, :n, :n] = filtered_cov
    own = np.arange(n, n + n_w)
    cov[:, own, own] = noise.intensity / steps[:, None]
    return Joint(np.hstack([filtered, np.zeros((samples, n_w))]), cov)


def smooth_ekf(filtered: EkfRun, data: Record, noise: Noise) -> Joint:
    """(x[k], w̄[k]) given all outputs, from an extended filter's run over `data`."""
    n_samples, n = filtered.filtered.shape
    closed, drive, information = _backward_terms(filtered, data, noise)
    # The recursion runs from the last sample: r[k-1] = Fᵀ r[k] + b, N[k-1] = Fᵀ N[k] F + W.
    rows = np.hstack([part.reshape(n_samples, -1)[::-1] for part in (closed, drive, information)])
    states, _ = run(backward_step(n, 1), np.zeros(n + n * n), rows)
    after = np.vstack([np.zeros((1, n + n * n)), states[:-1]])[::-1]
    r, N = after[:, :n], after[:, n:].reshape(len(after), n, n)
    past = filtered_joint(data, noise, filtered.filtered, filtered.filtered_cov)
    reach = _reach(filtered.filtered_cov @ np.swapaxes(filtered.transition, 1, 2), filtered.noise)
    loss = reach @ N @ np.swapaxes(reach, 1, 2)
    return Joint(
        past.mean + np.einsum("kij,kj->ki", reach, r), past.cov - (loss + np.swapaxes(loss, 1, 2)) / 2
    )


def _reach(cross: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Covariance (n_samples, n + n_w, n) of (x[k], w̄[k]) with the state at the next sample; none at the
    last."""
    reach = np.concatenate([cross, np.swapaxes(noise, 1, 2)], axis=1)
    reach[-1] = 0.0
    return reach


def _backward_terms(
    filtered: EkfRun, data: Record, noise: Noise
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """F = Φ T (I - K C) with the projection T onto invariants, b = Cᵀ S⁻¹ ν and W = Cᵀ S⁻¹ C per sample; a
    missing output has a zero row."""
    there = np.isfinite(data.outputs)
    C = np.where(there[:, :, None], filtered.sight, 0.0)
    S = C @ filtered.predicted_cov @ np.swapaxes(C, 1, 2)
    own = np.arange(S.shape[1])
    S[:, own, own] += np.where(there, noise.variance, 1.0)
    root = np.linalg.inv(np.linalg.cholesky(S))
    white = np.where(there, filtered.innovations / np.sqrt(filtered.variances), 0.0)
    seen = root @ C
    information = np.swapaxes(seen, 1, 2) @ seen
    drive = np.einsum("kij,ki->kj", seen, white)
    closed = filtered.transition @ filtered.turn @ (np.eye(C.shape[2]) - filtered.predicted_cov @ information)
    return closed, drive, information


def smooth_ukf(filtered: UkfRun, data: Record, noise: Noise) -> Joint:
    """(x[k], w̄[k]) given all outputs, from an unscented filter's run over `data`."""
    n_samples, n = filtered.filtered.shape
    past = filtered_joint(data, noise, filtered.filtered, filtered.filtered_cov)
    reach = _reach(filtered.cross, filtered.noise)
    gain = np.zeros_like(reach)
    gain[:-1] = reach[:-1] @ _inverse(filtered.predicted_cov[1:])
    mean, cov = past.mean.copy(), past.cov.copy()
    for k in range(n_samples - 2, -1, -1):
        mean[k] += gain[k] @ (mean[k + 1, :n] - filtered.predicted[k + 1])
        gained = gain[k] @ (cov[k + 1, :n, :n] - filtered.predicted_cov[k + 1]) @ gain[k].T
        cov[k] += (gained + gained.T) / 2
    return Joint(mean, cov)


def _inverse(cov: np.ndarray) -> np.ndarray:
    """Pseudo-inverses of covariances (n_samples, n, n), units scaled out."""
    size = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    size = np.where(size > 0.0, size, 1.0)
    pair = size[:, :, None] * size[:, None, :]
    return np.linalg.pinv(cov / pair, rcond=RANK_TOLERANCE, hermitian=True) / pair
