"""Sizes and scales of the columns of large sparse matrices, without copies of their structure, and products
with matrices whose rows and columns come in groups of multiples."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from daest.model.linear import GroupedMatrix
from daest.numerics.sparse_parts import entries_of


def pencil_entries(E: sp.csr_array, J: sp.csr_array) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The entries (row, column, power of s, value) of sE - J that are not zero."""
    first, second = sp.coo_array(E), sp.coo_array(J)
    row, column = (np.concatenate([first.coords[i], second.coords[i]]) for i in (0, 1))
    power = np.repeat([1, 0], [first.data.size, second.data.size])
    value = np.concatenate([first.data, -second.data])
    kept = value != 0.0
    return row[kept], column[kept], power[kept], value[kept]


def compressed(dense: np.ndarray) -> sp.csc_array:
    """The entries that are not zero, by columns: several times as fast as by way of triplets. Shapes:
    dense (n, m)."""
    by_column = np.ascontiguousarray(dense.T)
    kept = by_column != 0.0
    indices = (np.flatnonzero(kept) % dense.shape[0]).astype(np.int32)
    pointers = np.concatenate([[0], np.cumsum(np.count_nonzero(kept, axis=1))])
    return sp.csc_array((by_column[kept], indices, pointers), shape=dense.shape)


def scaled(matrix: sp.csc_array, left: np.ndarray, right: np.ndarray) -> sp.csc_array:
    """diag(left) · matrix · diag(right), on the structure of `matrix`. Shapes: matrix (n, m), left (n,),
    right (m,)."""
    data = matrix.data * left[matrix.indices]
    data *= np.repeat(right, np.diff(matrix.indptr))
    return sp.csc_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def scaled_norms(matrix: sp.csc_array, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Lengths of the columns of diag(left) · matrix · diag(right). Shapes: matrix (n, m), left (n,), right
    (m,); lengths (m,)."""
    squares = matrix.data * left[matrix.indices]
    squares *= squares
    return np.sqrt(_reduced(np.add, squares, matrix)) * np.abs(right)


def largest_entries(matrix: sp.csc_array) -> np.ndarray:
    """Largest size of an entry of each column, 0 where there is none. Shapes: matrix (n, m); sizes (m,)."""
    return _reduced(np.maximum, np.abs(matrix.data), matrix)


def _reduced(operation: np.ufunc, values: np.ndarray, matrix: sp.csc_array) -> np.ndarray:
    """The entries of each column brought together by `operation`; 0 for columns without entries."""
    found = np.zeros(matrix.shape[1])
    used = np.flatnonzero(np.diff(matrix.indptr))
    if used.size:
        found[used] = operation.reduceat(values, matrix.indptr[used])
    return found


def ungrouped(matrix: sp.csc_array) -> GroupedMatrix:
    """The matrix with every row and every column a group of its own. Shapes: matrix (n, m)."""
    n_rows, n_columns = matrix.shape
    return GroupedMatrix(matrix, np.arange(n_rows), np.ones(n_rows), np.arange(n_columns), np.ones(n_columns))


def product(matrix: GroupedMatrix, b: np.ndarray) -> np.ndarray:
    """matrix · b for a column b (n,) with few entries that are not zero."""
    core, value = matrix.core, np.zeros(matrix.core.shape[0] + 1)
    for k in np.flatnonzero((b != 0.0) & (matrix.column_group >= 0)):
        span = column_span(core, int(matrix.column_group[k]))
        value[core.indices[span]] += core.data[span] * (matrix.column_factor[k] * b[k])
    return matrix.row_factor * value[matrix.row_group]  # row -1 is the zero at the end


def column_entries(matrix: GroupedMatrix, k: int) -> tuple[np.ndarray, np.ndarray]:
    """(rows, values) of the entries of column k that are stored, rows in increasing order."""
    if matrix.column_group[k] < 0:
        return np.empty(0, dtype=int), np.empty(0)
    span = column_span(matrix.core, int(matrix.column_group[k]))
    places, counts = entries_of(matrix.row_members, matrix.core.indices[span])
    rows = matrix.row_members.indices[places]
    values = np.repeat(matrix.core.data[span] * matrix.column_factor[k], counts) * matrix.row_factor[rows]
    order = np.argsort(rows)
    return rows[order], values[order]


def column_norms(matrix: GroupedMatrix, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Lengths of the columns of diag(left) · matrix · diag(right). Shapes: matrix (n, m), left (n,), right
    (m,); lengths (m,)."""
    used = matrix.row_group >= 0
    squares = np.square(matrix.row_factor * left)[used]
    weights = np.sqrt(np.bincount(matrix.row_group[used], squares, minlength=matrix.core.shape[0]))
    norms = scaled_norms(matrix.core, weights, np.ones(matrix.core.shape[1]))
    return np.append(norms, 0.0)[matrix.column_group] * np.abs(matrix.column_factor * right)


def column_span(matrix: sp.csc_array, k: int) -> slice:
    """Where the entries of column k stand. Shapes: matrix (n, m)."""
    return slice(int(matrix.indptr[k]), int(matrix.indptr[k + 1]))
