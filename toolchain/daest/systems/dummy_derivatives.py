"""Choice of states: which derivatives of a differentiated system become plain unknowns (dummy derivatives).

Mattsson & Söderlind, SIAM J. Sci. Comput. 14 (1993): per stage, as many highest derivatives as there are
differentiated equations, so that the Jacobian of these equations in them is regular.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

# A dummy derivative of low preference is taken while its pivot, relative to its equation, is at least this.
PIVOT_CONSTANT = 1e-4  # coefficients do not change with the state: only rounding counts
PIVOT_VARYING = 0.3  # they do: keep away from the configuration in which the pivot vanishes
# Pivots closer than this are equal: the later variable becomes the dummy, the earlier one the state.
PIVOT_TIE = 1e-6


class DependentEquations(Exception):
    """Differentiated equations `rows` depend on each other at this point: no choice of states exists."""

    def __init__(self, rows: tuple[int, ...]) -> None:
        super().__init__(f"dependent rows {rows}")
        self.rows = rows


def dummy_counts(
    leading: sp.csr_array, times: np.ndarray, highest: np.ndarray, rank: np.ndarray, pivot: float
) -> np.ndarray:
    """How many derivatives of every unknown, from the highest down, become dummies; shape (n,).

    `leading` (n, n) is the Jacobian of the differentiated equations in the highest derivatives, `times` and
    `highest` are the differentiation counts of equations and unknowns. `rank[o, j]` is the wish to keep the
    derivative of order o of unknown j as a state. Raises `DependentEquations`."""
    dummies = np.zeros(highest.size, dtype=int)
    columns = np.flatnonzero(highest >= 1)
    for stage in range(1, int(times.max(initial=0)) + 1):
        rows = np.flatnonzero(times >= stage)
        columns = columns[highest[columns] >= stage]
        wish = rank[highest[columns] - stage, columns]
        chosen = _independent_columns(leading[rows][:, columns].tocsr(), wish, pivot, rows)
        columns = columns[chosen]
        dummies[columns] += 1
    return dummies


def _independent_columns(block: sp.csr_array, wish: np.ndarray, pivot: float, rows: np.ndarray) -> np.ndarray:
    """Positions of as many columns as rows, independent, of lowest wish; solved per connected component."""
    n_rows = block.shape[0]
    graph = sp.block_array([[None, block], [block.T, None]])
    _, label = connected_components(graph, directed=False)
    chosen: list[int] = []
    for component in np.unique(label[:n_rows]):
        own_rows = np.flatnonzero(label[:n_rows] == component)
        own_columns = np.flatnonzero(label[n_rows:] == component)
        dense = block[own_rows][:, own_columns].toarray()
        picked = _pivot_columns(dense, wish[own_columns], pivot)
        if len(picked) < own_rows.size:
            raise DependentEquations(tuple(rows[own_rows[_dependent_rows(dense)]].tolist()))
        chosen += own_columns[picked].tolist()
    return np.array(sorted(chosen), dtype=int)


def _pivot_columns(block: np.ndarray, wish: np.ndarray, pivot: float) -> list[int]:
    """Columns in order of wish, the largest remaining pivot first within one wish; two passes: good, then
    any."""
    remaining = block / np.maximum(np.abs(block).max(axis=1, keepdims=True), np.finfo(float).tiny)
    smallest = max(block.shape) * np.finfo(float).eps * max(1.0, np.linalg.norm(remaining))
    picked: list[int] = []
    for threshold in (pivot, smallest):
        for value in np.unique(wish):
            candidates = wish == value
            candidates[picked] = False
            picked += _greedy(remaining, candidates, threshold, block.shape[0] - len(picked))
    return picked


def _greedy(remaining: np.ndarray, candidates: np.ndarray, threshold: float, wanted: int) -> list[int]:
    """Take `candidates` (bool per column) by largest remaining norm and project them out of `remaining` (in
    place), where they have entries: constraints are mostly local."""
    picked: list[int] = []
    norms = np.where(candidates, np.linalg.norm(remaining, axis=0), 0.0)
    while len(picked) < wanted and norms.max(initial=0.0) > threshold:
        column = int(np.flatnonzero(norms >= (1 - PIVOT_TIE) * norms.max())[-1])
        direction = remaining[:, column] / norms[column]
        rows = np.flatnonzero(np.abs(direction) > np.finfo(float).eps)
        shares = direction[rows] @ remaining[rows]
        touched = np.flatnonzero(shares)
        remaining[np.ix_(rows, touched)] -= np.outer(direction[rows], shares[touched])
        picked.append(column)
        norms[column] = 0.0
        touched = touched[norms[touched] > 0.0]
        norms[touched] = np.linalg.norm(remaining[:, touched], axis=0)
    return picked


def _dependent_rows(block: np.ndarray) -> np.ndarray:
    """Rows that take part in the left null space."""
    left, singular, _ = np.linalg.svd(block)
    rank = int(np.sum(singular > max(block.shape) * np.finfo(float).eps * singular.max(initial=0.0)))
    share = np.abs(left[:, rank:]).max(axis=1, initial=0.0)
    return np.flatnonzero(share > np.sqrt(np.finfo(float).eps))


def dependent_rows(block: np.ndarray) -> np.ndarray:
    """The rows that make a square block singular (empty where it is regular), units scaled out."""
    return _dependent_rows(_equilibrate(block))


def _equilibrate(block: np.ndarray) -> np.ndarray:
    """Rows, then columns scaled to largest entry 1, so that units do not decide about rank."""
    tiny = np.finfo(float).tiny
    scaled = block / np.maximum(np.abs(block).max(axis=1, keepdims=True), tiny)
    return scaled / np.maximum(np.abs(scaled).max(axis=0, keepdims=True), tiny)
