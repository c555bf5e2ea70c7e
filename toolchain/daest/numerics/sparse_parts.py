"""Small parts of large sparse matrices, at a cost that grows with the part and not with the whole."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import breadth_first_order

SHALLOW = 40
"""Steps of a search from many vertices at once; paths that are longer are followed vertex by vertex."""


def entries_of(matrix: sp.csr_array, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(places, counts): where the entries of `rows` stand in `matrix.indices`, one row after the other, and
    how many each row has. Shapes: rows (k,), counts (k,)."""
    starts = matrix.indptr[rows]
    counts = matrix.indptr[rows + 1] - starts
    ends = np.cumsum(counts)
    total = int(ends[-1]) if ends.size else 0
    return np.arange(total) + np.repeat(starts - ends + counts, counts), counts


def submatrix(matrix: sp.csr_array, rows: np.ndarray, columns: np.ndarray) -> sp.csc_array:
    """matrix[rows][:, columns]. Shapes: rows (k,), columns (m,), all different."""
    places, counts = entries_of(matrix, rows)
    position = np.full(matrix.shape[1], -1, dtype=np.int32)
    position[columns] = np.arange(columns.size)
    column = position[matrix.indices[places]]
    kept = column >= 0
    row = np.repeat(np.arange(rows.size), counts)[kept]
    return sp.csc_array((matrix.data[places[kept]], (row, column[kept])), shape=(rows.size, columns.size))


def reached(graph: sp.csr_array, start: np.ndarray) -> np.ndarray:
    """Vertices on paths from those of `start`, in increasing order. Shapes: graph (n, n), start (k,)."""
    seen = np.zeros(graph.shape[0], dtype=bool)
    seen[start] = True
    ring = start
    for _ in range(SHALLOW):
        if ring.size == 0:
            return np.flatnonzero(seen)
        following = graph.indices[entries_of(graph, ring)[0]]
        ring = np.unique(following[~seen[following]])
        seen[ring] = True
    return _reached_far(graph, start)


def _reached_far(graph: sp.csr_array, start: np.ndarray) -> np.ndarray:
    """As `reached`, by one search from a further vertex with edges to all of `start`."""
    n = graph.shape[0]
    pointers = np.append(graph.indptr, graph.nnz + start.size)
    indices = np.concatenate([graph.indices, start])
    extended = sp.csr_array((np.ones(indices.size, np.int8), indices, pointers), shape=(n + 1, n + 1))
    order = breadth_first_order(extended, n, return_predecessors=False)
    return np.sort(order[order < n])
