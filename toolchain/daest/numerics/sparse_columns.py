"""Sizes and scales of the columns of large sparse matrices, without copies of their structure."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


def compressed(dense: np.ndarray) -> sp.csc_array:
    """The entries that are not zero, by columns: several times as fast as by way of triplets."""
    by_column = np.ascontiguousarray(dense.T)
    kept = by_column != 0.0
    indices = (np.flatnonzero(kept) % dense.shape[0]).astype(np.int32)
    pointers = np.concatenate([[0], np.cumsum(np.count_nonzero(kept, axis=1))])
    return sp.csc_array((by_column[kept], indices, pointers), shape=dense.shape)


def scaled(matrix: sp.csc_array, left: np.ndarray, right: np.ndarray) -> sp.csc_array:
    """diag(left) · matrix · diag(right), on the structure of `matrix`."""
    data = matrix.data * left[matrix.indices]
    data *= np.repeat(right, np.diff(matrix.indptr))
    return sp.csc_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def scaled_norms(matrix: sp.csc_array, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Lengths of the columns of diag(left) · matrix · diag(right)."""
    squares = matrix.data * left[matrix.indices]
    squares *= squares
    return np.sqrt(_reduced(np.add, squares, matrix)) * np.abs(right)


def largest_entries(matrix: sp.csc_array) -> np.ndarray:
    """Largest size of an entry of each column, 0 where there is none."""
    return _reduced(np.maximum, np.abs(matrix.data), matrix)


def _reduced(operation: np.ufunc, values: np.ndarray, matrix: sp.csc_array) -> np.ndarray:
    """The entries of each column brought together by `operation`; 0 for columns without entries."""
    found = np.zeros(matrix.shape[1])
    used = np.flatnonzero(np.diff(matrix.indptr))
    if used.size:
        found[used] = operation.reduceat(values, matrix.indptr[used])
    return found
