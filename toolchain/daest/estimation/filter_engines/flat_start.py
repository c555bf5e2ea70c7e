"""Unknown initial state: a regression of the innovations on x[0], and the correction of estimates by it.

A pass from a reference start has innovations ν - V δ, where δ is the unknown part of x[0] (Rosenberg 1973, de
Jong 1991). The regression on δ after every sample gives its mean and covariance, and the directions of δ
about which the outputs so far say nothing.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from daest.estimation.gates import FIT
from daest.model.estimates import FilterPass, FlatStart, GaussianSequence, Varying

_AT_ONCE = 4096  # samples whose normal equations are held in memory


def whitening(S: np.ndarray) -> np.ndarray:
    """L⁻¹ of S = L Lᵀ, (..., n_y, n_y)."""
    return np.linalg.inv(np.linalg.cholesky(S))


def flat_start(forward: FilterPass) -> FlatStart:
    """Regression of the whitened innovations on δ, after every sample.

    By QR (square root of the information) and a singular value decomposition that leaves out directions below
    FIT.start_rank, as long as there are any; afterwards by cumulated normal equations.
    """
    n_kept, _, q = forward.sensitivity.shape
    p = forward.n_observable
    index = forward.index[:n_kept]
    white = forward.whitening[index]
    rows = white @ forward.innovation_sensitivity[:, :, :p]
    right = (white @ forward.innovations[:n_kept, :, None])[:, :, 0]
    mean: np.ndarray = np.zeros((n_kept, q))
    factor: np.ndarray = np.zeros((n_kept, q, q))
    free: np.ndarray = np.zeros((n_kept, q, q))
    free[:, p:, p:] = np.eye(q - p)
    root: np.ndarray = np.zeros((p, p + 1))
    for k in range(n_kept):
        stacked = np.vstack([root, np.column_stack([rows[k], right[k]])])
        root = np.asarray(np.linalg.qr(stacked, mode="r"))[:p]
        mean[k, :p], factor[k, :p, :p], free[k, :p, :p], condition = solve_root(root[:, :p], root[:, p])
        if np.isfinite(condition):
            _cumulate(root, rows[k + 1 :], right[k + 1 :], mean[k + 1 :, :p], factor[k + 1 :, :p, :p])
            break
    return FlatStart(mean, factor, free)


def one_earlier(flat: FlatStart) -> FlatStart:
    """What was known about δ before each sample: nothing before the first."""
    n_kept, q = flat.mean.shape
    if n_kept == 0:
        return flat
    first_free = np.eye(q)[None]
    return FlatStart(
        np.concatenate([np.zeros((1, q)), flat.mean[:-1]]),
        np.concatenate([np.zeros((1, q, q)), flat.factor[:-1]]),
        np.concatenate([first_free, flat.free[:-1]]),
    )


def correct(
    mean: np.ndarray,
    cov: np.ndarray,
    index: np.ndarray,
    loads: np.ndarray,
    flat: FlatStart,
    scale: np.ndarray,
) -> GaussianSequence:
    """Add the unknown start: vector = N(mean, cov) + loads δ for the first samples, in place in `mean`.

    cov (n_distinct, m, m) by `index`; loads (n_kept, m, q); δ as in `flat`, whose first axis is n_kept.
    """
    n_kept, m, q = loads.shape
    if n_kept == 0 or q == 0:
        return GaussianSequence(mean, Varying(cov, index), _nothing_free(m, index.size), scale)
    mean[:n_kept] += np.einsum("kmq,kq->km", loads, flat.mean)
    spread = loads @ flat.factor
    total = cov[index[:n_kept]] + spread @ np.swapaxes(spread, 1, 2)
    free, free_index = _free_loads(loads @ flat.free, index.size)
    numbers = np.concatenate([np.arange(n_kept), n_kept + index[n_kept:]])
    rest = cov if n_kept < index.size else cov[:0]
    return GaussianSequence(
        mean, Varying(np.concatenate([total, rest]), numbers), Varying(free, free_index), scale
    )


def flat_evidence(flat: FlatStart, forward: FilterPass, start: np.ndarray) -> float:
    """log ∫ exp(δᵀ s - δᵀ Λ δ / 2) dx0 over the observable δ, with x[0] = … + start δ, start (n, q).

    = (sᵀ Λ⁻¹ s - log |Λ| + p log 2π) / 2 + log |dx0 / dδ|; NaN when the record does not determine δ.
    """
    p, n_kept = forward.n_observable, flat.mean.shape[0]
    white = forward.whitening[forward.index[:n_kept]]
    rows = (white @ forward.innovation_sensitivity[:, :, :p]).reshape(-1, p)
    fitted = rows @ flat.mean[-1, :p]  # s = Λ δ̂, so that sᵀ Λ⁻¹ s = |rows δ̂|²
    values = np.linalg.svd(flat.factor[-1, :p, :p], compute_uv=False)
    if np.any(values == 0.0):
        return float("nan")
    columns = np.linalg.svd(start[:, :p], compute_uv=False)
    log_size = np.sum(np.log(values)) + np.sum(np.log(columns))
    return float(0.5 * (fitted @ fitted + p * np.log(2 * np.pi)) + log_size)


def solve_root(R: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Minimum-norm solution of R δ = right, a root of (RᵀR)⁺, the undetermined directions and the condition.
    Shapes: R (m, p) with m ≤ p, right (m,); solution (p,), root and directions (p, p)."""
    p = R.shape[1]
    full = np.zeros((p, p))
    full[: R.shape[0]] = R
    rest = np.zeros(p)
    rest[: right.shape[0]] = right
    left, values, directions = np.linalg.svd(full)
    kept = values > FIT.start_rank * values[0] if p else np.zeros(0, dtype=bool)
    inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    factor = directions.T * inverse
    condition = values[0] / values[-1] if p and np.all(kept) else (np.inf if p else 1.0)
    return factor @ (left.T @ rest), factor, directions.T * ~kept, condition


def _cumulate(
    root: np.ndarray, rows: np.ndarray, right: np.ndarray, mean: np.ndarray, factor: np.ndarray
) -> None:
    """Continue the regression from its triangular root [R | r] by normal equations; writes `mean` and
    `factor`.

    They are those of R δ, whose information is the identity at first, so that directions about which much and
    little is known do not spoil each other. Where it has grown, R is made anew, by QR.
    """
    n, p = rows.shape[0], rows.shape[2]
    begin = 0
    while p and begin < n:
        R, r = root[:, :p], root[:, p]
        inverse = solve_triangular(R, np.eye(p))
        end = min(n, begin + _AT_ONCE)
        scaled = rows[begin:end] @ inverse
        information = np.cumsum(np.swapaxes(scaled, 1, 2) @ scaled, axis=0) + np.eye(p)
        # The first row may bring much: it is no more than one step of QR.
        known = np.trace(information, axis1=1, axis2=2) <= FIT.well_conditioned**2
        end = begin + max(1, int(np.count_nonzero(known)))
        done = slice(begin, end)
        information, scaled = information[: end - begin], scaled[: end - begin]
        vector = np.cumsum(np.einsum("kyp,ky->kp", scaled, right[done]), axis=0) + r
        inverse_root = whitening(information)
        factor[done] = inverse @ np.swapaxes(inverse_root, 1, 2)
        mean[done] = np.einsum("kab,kb->ka", factor[done], np.einsum("kab,kb->ka", inverse_root, vector))
        stacked = np.column_stack([rows[done].reshape(-1, p), right[done].reshape(-1)])
        root = np.asarray(np.linalg.qr(np.vstack([root, stacked]), mode="r"))[:p]
        begin = end


def _nothing_free(m: int, n_samples: int) -> Varying:
    return Varying(np.zeros((1, m, 0)), np.zeros(n_samples, dtype=np.int64))


def _free_loads(free: np.ndarray, n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Free directions of the first samples, zero for the others; samples without any share entry 0."""
    some = np.any(free != 0.0, axis=(1, 2))
    index = np.zeros(n_samples, dtype=np.int64)
    index[: free.shape[0]] = np.where(some, np.cumsum(some), 0)
    return np.concatenate([np.zeros((1, *free.shape[1:])), free[some]]), index
