"""Bases of the row space of large matrices: independent rows, and columns that tell them apart."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from daest.numerics.elimination import choose_pivots
from daest.numerics.ranks import default_tolerance

PARALLEL = 1e-10
"""Rows that differ by less than this from multiples of each other are one row, for the choice of a basis."""

DENSE_SHARE = 0.05
"""From this share of non-zero entries on, a matrix is eliminated as a dense one."""


def independent_block(matrix: sp.csr_array | sp.csc_array) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of a regular block of `matrix` that is as large as its rank.

    Entries of `matrix` are of comparable size; what elimination leaves below 256 n eps times the
    largest entry is zero. Sparse elimination, or QR with pivoting where there is little to save.
    Shapes: matrix (n, m) of rank r; rows and columns (r,).
    """
    rows, columns = different_rows(sp.csr_array(matrix))[0], different_rows(sp.csr_array(matrix.T))[0]
    core = sp.csr_array(matrix[rows][:, columns])
    if core.nnz == 0:
        return np.empty(0, dtype=int), np.empty(0, dtype=int)
    core = sp.csr_array(core / abs(core).max())
    zero = default_tolerance(max(core.shape))
    if core.nnz > DENSE_SHARE * core.shape[0] * core.shape[1]:
        picked, opposite = _dense_block(core.toarray(), zero)
    else:
        pivots = choose_pivots(core, np.arange(len(rows)), np.ones(len(columns), dtype=bool), zero)
        picked, opposite = pivots.rows, pivots.columns
    return rows[picked], columns[opposite]


def different_rows(matrix: sp.csr_array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(representatives, group, factor): row i is factor[i] times row representatives[group[i]], the largest
    of its group, for a small one may be a rounding error.

    Rows of zeros belong to no group (-1, factor 0).
    """
    n = matrix.shape[0]
    matrix = sp.csr_array(matrix)
    matrix.sort_indices()
    known: dict[bytes, int] = {}
    representatives: list[int] = []  # of each group, in the order of their first rows
    group, factor, scale = np.full(n, -1), np.zeros(n), np.ones(n)
    for i in range(n):
        span = slice(matrix.indptr[i], matrix.indptr[i + 1])
        values = matrix.data[span]
        largest = values[np.argmax(np.abs(values))] if values.size else 0.0
        if largest == 0.0:
            continue
        rounded = np.round(values / (largest * PARALLEL)).astype(np.int64)
        key = matrix.indices[span].tobytes() + rounded.tobytes()
        if key not in known:
            known[key] = len(representatives)
            representatives.append(i)
        group[i], scale[i] = known[key], largest
        if abs(largest) > abs(scale[representatives[group[i]]]):
            representatives[group[i]] = i
    used = group >= 0
    first = np.array(representatives, dtype=int)
    factor[used] = scale[used] / scale[first[group[used]]]
    return first, group, factor


def _dense_block(matrix: np.ndarray, zero: float) -> tuple[np.ndarray, np.ndarray]:
    _, R, order = sla.qr(matrix.T, mode="raw", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diag(R)) > zero))
    rows = order[:rank]
    _, swaps = sla.lu_factor(matrix[rows].T)  # the rows are independent: any pivots do
    columns = np.arange(matrix.shape[1])
    for k, other in enumerate(swaps):
        columns[[k, other]] = columns[[other, k]]
    return rows, columns[:rank]
