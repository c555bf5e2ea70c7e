"""Gaussian steps: one step of the backward companion of the Kalman recursion, compiled by CasADi, and
marginals.

A step function maps (state, data) to (next state, results), all as flat row-major vectors; `run` folds it
over many samples without a Python step per sample.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.model.estimates import GaussianSequence

CHUNK = 128  # samples per compiled call
SCALAR_SIZE = 20  # up to this many states a step is expanded into scalar operations; above, into matrix ones
BLOCK = 4_000_000  # numbers of a block of products of `marginals`: 32 MB
SPARSE_SHARE = 0.1  # of entries of large rows: above it, products are those of dense matrices
FREE_TOLERANCE = 1e-8  # a component is undetermined when it moves by more than this part of its scale


@lru_cache(maxsize=32)
def backward_step(n: int, n_columns: int) -> ca.Function:
    """CHUNK steps of r ← Fᵀ r + b, N ← Fᵀ N F + W for [r] (n, n_columns) and N (n, n); data F, b, W; no
    results.

    With b = Cᵀ S⁻¹ ν and W = Cᵀ S⁻¹ C this is the backward recursion of the Bryson-Frazier smoother.
    """
    symbol: Any = ca.SX.sym if n <= SCALAR_SIZE else ca.MX.sym
    state = symbol("state", n * n_columns + n * n)
    r, N = _parts(state, (n, n_columns), (n, n))
    data = symbol("data", 2 * n * n + n * n_columns)
    F, b, W = _parts(data, (n, n), (n, n_columns), (n, n))
    N_before = F.T @ N @ F + W
    return _folded(state, data, _flat(F.T @ r + b, (N_before + N_before.T) / 2), type(state)(0, 1))


def run(step: ca.Function, state: np.ndarray, data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fold `step` over the rows of `data` (n_steps, n_data): states after each (n_steps, n_state),
    results."""
    n_steps = data.shape[0]
    states = np.empty((n_steps, state.shape[0]))
    results = np.empty((n_steps, step.size1_out(1)))
    for start in range(0, n_steps, CHUNK):
        stop = min(start + CHUNK, n_steps)
        rows = np.minimum(np.arange(start, start + CHUNK), n_steps - 1)  # the last chunk repeats its last row
        after, result = _call(step, state, np.ascontiguousarray(data[rows]))
        states[start:stop], results[start:stop] = after[: stop - start], result[: stop - start]
        state = states[stop - 1]
    return states, results


def marginals(sequence: GaussianSequence, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation (n_samples, m) of rows @ vector, rows (m, n).

    NaN and inf where a row sees a free direction by more than FREE_TOLERANCE of its own scale Σ |row| scale.
    """
    mean = sequence.mean @ rows.T
    variance = quadratic_forms(rows, sequence.cov.distinct)
    std = np.sqrt(np.maximum(variance, 0.0))[sequence.cov.index]
    open_ = undetermined(sequence.free.distinct, rows, sequence.scale)
    if np.any(open_):
        open_ = open_[sequence.free.index]
        mean, std = np.where(open_, np.nan, mean), np.where(open_, np.inf, std)
    return mean, std


def quadratic_forms(rows: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """rows_i' cov_k rows_i as (k, i), for as many k at a time as fit into `BLOCK` numbers."""
    result = np.empty((len(cov), len(rows)))
    if rows.size > BLOCK and np.count_nonzero(rows) < SPARSE_SHARE * rows.size:
        sparse = sp.csr_array(rows)
        for k, one in enumerate(cov):
            result[k] = sparse.multiply(sparse @ one).sum(axis=1)
        return result
    step = max(1, BLOCK // max(rows.size, 1))
    for start in range(0, len(cov), step):
        products = rows @ cov[start : start + step]
        result[start : start + step] = (products * rows).sum(axis=2)
    return result


def undetermined(free: np.ndarray, rows: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Which rows (m, n) see a free direction; free (..., n, q) -> bool (..., m)."""
    if free.ndim == 3:
        seen = np.empty((len(free), len(rows)))
        step = max(1, BLOCK // max(len(rows) * free.shape[2], 1))
        for start in range(0, len(free), step):
            seen[start : start + step] = np.linalg.norm(rows @ free[start : start + step], axis=-1)
    else:
        seen = np.linalg.norm(rows @ free, axis=-1)
    return seen > FREE_TOLERANCE * (np.abs(rows) @ scale)


def _call(step: ca.Function, state: np.ndarray, data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    after = np.empty((CHUNK, step.size1_out(0)))
    result = np.empty((CHUNK, step.size1_out(1)))
    state = np.ascontiguousarray(state)
    buffer: Any
    buffer, trigger = step.buffer()
    buffer.set_arg(0, state.data)
    buffer.set_arg(1, data.data)
    buffer.set_res(0, after.data)
    if result.size:
        buffer.set_res(1, result.data)
    trigger()
    return after, result


def _folded(state: Any, data: Any, following: Any, results: Any) -> ca.Function:
    return ca.Function("step", [state, data], [following, results]).mapaccum("steps", CHUNK)


def _parts(vector: Any, *shapes: tuple[int, int]) -> list[Any]:
    """Row-major matrices cut from one vector, in order."""
    sizes = np.cumsum([0] + [rows * columns for rows, columns in shapes])
    return [
        ca.reshape(vector[int(start) : int(stop)], columns, rows).T
        for start, stop, (rows, columns) in zip(sizes[:-1], sizes[1:], shapes, strict=True)
    ]


def _flat(*matrices: Any) -> Any:
    return ca.vertcat(*[ca.vec(ca.densify(matrix).T) for matrix in matrices])
