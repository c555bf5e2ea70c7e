"""Some entries of the inverse of a large sparse matrix, from its factors: `selected.c`."""

from __future__ import annotations

import ctypes
import functools
from typing import Any

import numpy as np
import scipy.sparse as sp

from daest.numerics.compiler import loaded, pointer, text_of

MOST_ENTRIES = 100_000_000
"""Entries of both factors up to which they are made: some 2.4 GB."""


def inverse_diagonal(matrix: sp.csc_array, factors: Any, wanted: np.ndarray) -> np.ndarray | None:
    """(matrix⁻¹)_kk for the k in `wanted`, places where the diagonal of `matrix` has an entry.

    `factors` are those of scipy's `splu`, whose order of rows and columns needs no pivots. None without a C
    compiler, where a pivot is zero in spite of that, and where the factors have too many entries. Shapes:
    matrix (n, n), wanted (k,).
    """
    library = _library()
    if library is None:
        return None
    entries = sp.coo_array(matrix)
    row, column = factors.perm_r[entries.coords[0]], factors.perm_c[entries.coords[1]]
    ordered = sp.csc_array((entries.data, (row, column)), shape=matrix.shape)
    ordered.sort_indices()
    arrays = (
        np.ascontiguousarray(ordered.indptr, dtype=np.int64),
        np.ascontiguousarray(ordered.indices, dtype=np.int32),
        np.ascontiguousarray(ordered.data, dtype=float),
    )
    places = [
        np.ascontiguousarray(order[wanted], dtype=np.int32) for order in (factors.perm_r, factors.perm_c)
    ]
    found = np.empty(wanted.size)
    state: int = library.daest_selected(
        ctypes.c_long(matrix.shape[0]),
        *[pointer(array) for array in arrays],
        ctypes.c_int64(MOST_ENTRIES),
        ctypes.c_long(wanted.size),
        *[pointer(array) for array in places],
        pointer(found),
    )
    return None if state else found


@functools.lru_cache(maxsize=1)
def _library() -> ctypes.CDLL | None:
    """The compiled functions; None without a C compiler."""
    library = loaded(text_of("selected.c"), "selected")
    if library is not None:
        library.daest_selected.restype = ctypes.c_int
    return library
