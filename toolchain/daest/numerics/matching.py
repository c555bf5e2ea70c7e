"""Bipartite graphs of equations and unknowns: matching, defects, block triangular order, tearing.

Rows are equations, columns are unknowns; an incidence is a sparse matrix whose stored entries are the edges.
Nothing here looks at values except the orders of a signature matrix. Sources: Dulmage & Mendelsohn (1958) for
the coarse decomposition, Pryce, BIT 41 (2001) for the offsets, Elmqvist & Otter (1994) for tearing.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import (
    connected_components,
    maximum_bipartite_matching,
    min_weight_full_bipartite_matching,
)


@dataclass(frozen=True)
class Defect:
    """Where a square incidence has no perfect matching: `over_rows` are equations that compete for the too
    few unknowns `over_columns`; `under_columns` are unknowns that the too few equations `under_rows` cannot
    fix."""

    over_rows: tuple[int, ...]
    over_columns: tuple[int, ...]
    under_rows: tuple[int, ...]
    under_columns: tuple[int, ...]


@dataclass(frozen=True)
class Offsets:
    """Canonical offsets of a signature matrix σ: equation i is to be differentiated `rows[i]` times, and
    unknown j then occurs with highest derivative `columns[j]`. `column_of` is a highest-value transversal."""

    rows: np.ndarray
    columns: np.ndarray
    column_of: np.ndarray


@dataclass(frozen=True)
class Tearing:
    """An order to solve a loop in: guess the columns `tears`, solve each (row, column) of `causal` in turn,
    and close the loop with `residual_rows`, as many as there are tears."""

    tears: tuple[int, ...]
    causal: tuple[tuple[int, int], ...]
    residual_rows: tuple[int, ...]


def maximum_matching(incidence: sp.csr_array) -> np.ndarray:
    """Column matched to every row, -1 where a row stays free; shape (n_rows,)."""
    return np.asarray(maximum_bipartite_matching(sp.csr_matrix(incidence), perm_type="column"))


def find_defect(incidence: sp.csr_array) -> Defect | None:
    """The structural defect of a square incidence (coarse Dulmage-Mendelsohn parts), None if there is none.
    Shapes: incidence (n, n)."""
    column_of = maximum_matching(incidence)
    if np.all(column_of >= 0):
        return None
    row_of = np.full(incidence.shape[1], -1)
    matched = np.flatnonzero(column_of >= 0)
    row_of[column_of[matched]] = matched
    by_row, by_column = sp.csr_array(incidence), sp.csc_array(incidence)
    over_rows, over_columns = _alternating_reach(np.flatnonzero(column_of < 0), by_row, row_of)
    under_columns, under_rows = _alternating_reach(
        np.flatnonzero(row_of < 0), sp.csr_array(by_column.T), column_of
    )
    return Defect(over_rows, over_columns, under_rows, under_columns)


def _alternating_reach(
    free: np.ndarray, neighbours: sp.csr_array, partner: np.ndarray
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Vertices reached from the free ones by alternating paths, on their side and on the other side."""
    own, other, todo = set(free.tolist()), set(), free.tolist()
    while todo:
        vertex = todo.pop()
        for reached in neighbours.indices[neighbours.indptr[vertex] : neighbours.indptr[vertex + 1]].tolist():
            if reached in other:
                continue
            other.add(reached)
            mate = int(partner[reached])
            if mate >= 0 and mate not in own:
                own.add(mate)
                todo.append(mate)
    return tuple(sorted(own)), tuple(sorted(other))


def canonical_offsets(rows: np.ndarray, columns: np.ndarray, orders: np.ndarray, n: int) -> Offsets:
    """Smallest offsets c ≥ 0, d with d_j - c_i ≥ σ_ij, equality on a highest-value transversal.

    σ is given by its finite entries (rows, columns, orders), orders ≥ 0, n × n, with at most one entry per
    pair. These are the differentiation counts that Pantelides' algorithm finds. Needs a perfect matching
    (`find_defect`).
    """
    if not n:
        none = np.zeros(0, dtype=int)
        return Offsets(none, none, none)
    # The matching routine treats zeros as missing edges and minimises, so that weights are 1 + (max σ - σ).
    weights = sp.csr_matrix((1.0 + orders.max(initial=0) - orders, (rows, columns)), shape=(n, n))
    matched_rows, matched_columns = min_weight_full_bipartite_matching(weights)
    column_of = np.empty(n, dtype=int)
    column_of[matched_rows] = matched_columns
    sigma = sp.csr_matrix((orders + 1, (rows, columns)), shape=(n, n))
    diagonal = np.asarray(sigma[np.arange(n), column_of]).ravel().astype(int) - 1
    c = np.zeros(n, dtype=int)
    while True:
        d = np.zeros(n, dtype=int)
        np.maximum.at(d, columns, orders + c[rows])
        raised = d[column_of] - diagonal
        if np.array_equal(raised, c):
            return Offsets(c, d, column_of)
        c = raised


def block_triangular(incidence: sp.csr_array, column_of: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Diagonal blocks (rows, columns) of the block lower triangular form, in the order in which they can be
    solved.

    `column_of` is a perfect matching. Blocks without mutual dependence keep the order of their first row."""
    n = incidence.shape[0]
    depends = sp.csr_array(incidence)[
        :, column_of
    ]  # entry (i, k): equation i needs the unknown of equation k
    n_blocks, label = connected_components(depends, directed=True, connection="strong")
    members = np.argsort(label, kind="stable")
    blocks = np.split(members, np.cumsum(np.bincount(label, minlength=n_blocks))[:-1]) if n else []
    pairs = sp.coo_array(depends)
    edges = np.unique(np.stack([label[pairs.col], label[pairs.row]]), axis=1)
    edges = edges[:, edges[0] != edges[1]]
    order = _topological_order([int(rows[0]) for rows in blocks], edges)
    return [(blocks[b], column_of[blocks[b]]) for b in order]


def _topological_order(first_row: list[int], edges: np.ndarray) -> list[int]:
    """Order of the vertices in which every edge (from, to) points forward; ties by `first_row`."""
    waiting = np.bincount(edges[1], minlength=len(first_row))
    followers: list[list[int]] = [[] for _ in first_row]
    for source, target in edges.T.tolist():
        followers[source].append(target)
    ready = [(first_row[v], v) for v in range(len(first_row)) if waiting[v] == 0]
    heapq.heapify(ready)
    order = []
    while ready:
        _, vertex = heapq.heappop(ready)
        order.append(vertex)
        for target in followers[vertex]:
            waiting[target] -= 1
            if waiting[target] == 0:
                heapq.heappush(ready, (first_row[target], target))
    return order


def tear(
    incidence: list[set[int]], solvable: list[set[int]], n_columns: int, bent: frozenset[int] = frozenset()
) -> Tearing:
    """Tear a loop: row i contains the columns `incidence[i]` and may be solved for those in `solvable[i]`.

    Greedy: solve every row that has one unknown left; when none is left guess the unknown that occurs in most
    of the remaining rows, among those that no row can be solved for if there are any, else among the `bent`
    ones, in which a row is nonlinear: a law that flattens out is then read forwards, not backwards, and
    equal loops are torn alike wherever their rows stand."""
    left = {row: set(columns) for row, columns in enumerate(incidence)}
    rows_of: list[set[int]] = [set() for _ in range(n_columns)]
    for row, columns in left.items():
        for column in columns:
            rows_of[column].add(row)
    open_columns, tears, causal = set(range(n_columns)), [], []
    while open_columns:
        step = _causal_step(left, solvable, open_columns)
        if step is None:
            column = _tear_candidate(left, solvable, rows_of, open_columns, bent)
            tears.append(column)
        else:
            row, column = step
            causal.append(step)
            del left[row]
        open_columns.discard(column)
        for row in rows_of[column]:
            if row in left:
                left[row].discard(column)
    return Tearing(tuple(tears), tuple(causal), tuple(sorted(left)))


def _causal_step(
    left: dict[int, set[int]], solvable: list[set[int]], open_columns: set[int]
) -> tuple[int, int] | None:
    for row, columns in left.items():
        if len(columns) == 1:
            (column,) = columns
            if column in open_columns and column in solvable[row]:
                return row, column
    return None


def _tear_candidate(
    left: dict[int, set[int]],
    solvable: list[set[int]],
    rows_of: list[set[int]],
    open_columns: set[int],
    bent: frozenset[int],
) -> int:
    def weight(column: int) -> tuple[bool, bool, int, int]:
        rows = [row for row in rows_of[column] if row in left]
        is_stuck = not any(column in solvable[row] for row in rows)
        return is_stuck, column in bent, len(rows), -column

    return max(open_columns, key=weight)
