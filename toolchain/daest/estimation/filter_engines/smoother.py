"""Fixed-interval smoother of (47) for states and process noise: Bryson and Frazier's backward recursion.

With the innovations ν, their covariances S and the closed loop F = Φ - K C of the filter, backwards
from r = 0, N = 0:

    r[k-1] = Cᵀ S⁻¹ ν[k] + Fᵀ r[k],    N[k-1] = Cᵀ S⁻¹ C + Fᵀ N[k] F.

A vector z with covariance `reach` to ν[k] and `ahead` to the prediction error of x[k+1] has the smoothed mean
E z + reach S⁻¹ ν + ahead r[k] and loses the covariance reach S⁻¹ reachᵀ + ahead N[k] aheadᵀ. For x: reach = P
Cᵀ, ahead = P Fᵀ. For w̄: reach = R12, ahead = E w̄ w̃ᵀ - R12 Kᵀ. No covariance is inverted, so that Q may be
singular. The covariances are differences: an initial variance many powers of ten above the stationary one
costs digits in the first samples, an unknown initial state does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from daest.estimation.filter_engines.flat_start import correct
from daest.estimation.filter_engines.kalman import filtered_loads
from daest.estimation.filter_engines.modes import LONG_RUN, by_index
from daest.estimation.gates import FIT
from daest.model.estimates import FilterPass, FlatStart, KalmanResult, SmootherResult
from daest.numerics.gaussian import CHUNK, backward_step, run
from daest.numerics.recursions import linear_recursion
from daest.numerics.riccati import is_stable


@dataclass(frozen=True)
class _Backward:
    """r[k-1] (n_samples, n), its sensitivity to δ (n_kept, n, q), and N[k-1] as distinct matrices with an
    index."""

    r: np.ndarray
    sensitivity: np.ndarray
    information: np.ndarray
    index: np.ndarray


def smooth(result: KalmanResult) -> SmootherResult:
    """Mean and covariance of (x[k], w̄[k]) given the whole record, from a filter pass over it."""
    forward = result.forward
    backward = _backward_pass(forward)
    ahead = _ahead(forward)
    n = forward.predicted.shape[1]
    r_after = np.concatenate([backward.r[1:], np.zeros((1, n))])
    mean = forward.filtered + by_index(ahead, forward.index, r_after)
    cov, index = _smoothed_cov(forward, backward, ahead)
    loads = _smoothed_loads(forward, backward, ahead)
    flat = _final(result.flat_start)
    return SmootherResult(result.time, correct(mean, cov, index, loads, flat, result.scale))


def _ahead(forward: FilterPass) -> np.ndarray:
    """Covariance (n + n_w, n) of (x[k], w̄[k]) with the prediction error of x[k+1], by distinct entry."""
    modes, mode = forward.modes, forward.mode
    closed = modes.transition[mode] - forward.gain @ modes.output[mode]
    fed_back = modes.noise_measurement_cov[mode] @ np.swapaxes(forward.gain, 1, 2)
    noise = modes.noise_process_cov[mode] - fed_back
    return np.concatenate([forward.cov @ np.swapaxes(closed, 1, 2), noise], axis=1)


def _smoothed_cov(
    forward: FilterPass, backward: _Backward, ahead: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Covariances for known δ: one per distinct pair of filter entry and N."""
    n = forward.predicted.shape[1]
    nothing = backward.information.shape[0]
    information = np.concatenate([backward.information, np.zeros((1, n, n))])
    after = np.append(backward.index[1:], nothing)
    code = forward.index * (nothing + 1) + after
    _, first, index = np.unique(code, return_index=True, return_inverse=True)
    entry, N = forward.index[first], information[after[first]]
    loss = ahead[entry] @ N @ np.swapaxes(ahead[entry], 1, 2)
    return forward.filtered_cov[entry] - (loss + np.swapaxes(loss, 1, 2)) / 2, index


def _smoothed_loads(forward: FilterPass, backward: _Backward, ahead: np.ndarray) -> np.ndarray:
    loads = filtered_loads(forward)
    n_kept = loads.shape[0]
    if n_kept > 1:
        loads[:-1] += ahead[forward.index[: n_kept - 1]] @ backward.sensitivity[1:]
    return loads


def _final(flat: FlatStart) -> FlatStart:
    """What the whole record says about δ, at every sample."""
    return FlatStart(
        *(np.broadcast_to(part[-1:], part.shape) for part in (flat.mean, flat.factor, flat.free))
    )


def _backward_pass(forward: FilterPass) -> _Backward:
    n_samples, n = forward.predicted.shape
    n_kept, _, q = forward.sensitivity.shape
    terms = _Terms(forward)
    r_all, index = np.empty((n_samples, n)), np.empty(n_samples, dtype=np.int64)
    sensitivity, distinct = np.empty((n_kept, n, q)), []
    run_start = _run_starts(forward.index)
    k, r, N = n_samples, np.zeros((n, 1)), np.zeros((n, n))
    n_distinct = 0
    while k > 0:
        if k == n_kept and q:
            r = np.hstack([r, np.zeros((n, q))])
        lowest = n_kept if k > n_kept else 0
        begin = max(int(run_start[k - 1]), lowest)
        if k - begin >= LONG_RUN and terms.is_stationary(N, int(forward.index[k - 1])):
            rows = _constant_phase(terms, begin, k, r)
            matrices, numbers = N[None], np.zeros(k - begin, dtype=np.int64)
        else:
            begin = max(k - CHUNK, lowest, begin if k - begin >= LONG_RUN else 0)
            rows, matrices = _chunk(terms, begin, k, r, N)
            numbers = np.arange(k - begin)
        r_all[begin:k] = rows[:, :, 0]
        if begin < n_kept:
            sensitivity[begin:k] = rows[:, :, 1:]
        index[begin:k] = n_distinct + numbers
        distinct.append(matrices)
        n_distinct += matrices.shape[0]
        k, r, N = begin, rows[0], matrices[0]
    return _Backward(r_all, sensitivity, np.concatenate(distinct), index)


class _Terms:
    """F, Cᵀ S⁻¹ and Cᵀ S⁻¹ C by distinct entry, and the stationary N of an entry when asked for."""

    def __init__(self, forward: FilterPass) -> None:
        C = forward.modes.output[forward.mode]
        self.forward = forward
        self.closed = forward.modes.transition[forward.mode] - forward.gain @ C
        root = forward.whitening @ C
        self.weight = np.swapaxes(root, 1, 2) @ forward.whitening
        self.information = np.swapaxes(root, 1, 2) @ root
        self._limits: dict[int, np.ndarray | None] = {}

    def is_stationary(self, N: np.ndarray, entry: int) -> bool:
        if entry not in self._limits:
            F = self.closed[entry]
            known = is_stable(F)
            self._limits[entry] = (
                scipy.linalg.solve_discrete_lyapunov(F.T, self.information[entry]) if known else None
            )
        limit = self._limits[entry]
        if limit is None:
            return False
        size = np.sqrt(np.maximum(np.diagonal(limit), np.diagonal(N)))
        return bool(np.all(np.abs(N - limit) <= FIT.settled_smoother * np.outer(size, size)))

    def drive(self, begin: int, end: int, columns: int) -> np.ndarray:
        """Cᵀ S⁻¹ [ν -V] for samples begin … end - 1, (n_samples, n, columns)."""
        known = self.forward.innovations[begin:end, :, None]
        if columns > 1:
            known = np.concatenate([known, -self.forward.innovation_sensitivity[begin:end]], axis=2)
        index = self.forward.index[begin:end]
        if index[0] == index[-1] and np.all(index == index[0]):
            return self.weight[index[0]] @ known
        return self.weight[index] @ known


def _chunk(
    terms: _Terms, begin: int, end: int, r: np.ndarray, N: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """r[k-1] (n_samples, n, columns) and N[k-1] (n_samples, n, n) for samples begin … end - 1, given those at
    end."""
    n, columns = r.shape
    index = terms.forward.index[begin:end]
    parts = (terms.closed[index], terms.drive(begin, end, columns), terms.information[index])
    data = np.hstack([part.reshape(end - begin, -1) for part in parts])[::-1]
    states, _ = run(backward_step(n, columns), np.concatenate([r.ravel(), N.ravel()]), data)
    states = states[::-1]
    return (
        states[:, : n * columns].reshape(len(states), n, columns),
        states[:, n * columns :].reshape(len(states), n, n),
    )


def _constant_phase(terms: _Terms, begin: int, end: int, r: np.ndarray) -> np.ndarray:
    """r[k-1] (n_samples, n, columns) of a run with constant F."""
    drive = terms.drive(begin, end, r.shape[1]).transpose(2, 0, 1)[:, ::-1]
    F = terms.closed[terms.forward.index[begin]]
    states = linear_recursion(F.T, drive, r.T)[:, 1:]
    return states[:, ::-1].transpose(1, 2, 0)


def _run_starts(index: np.ndarray) -> np.ndarray:
    """For every sample, the start of the run of equal entries it belongs to."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(index)) + 1])
    return starts[np.searchsorted(starts, np.arange(index.size), side="right") - 1]
