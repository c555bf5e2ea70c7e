"""Sparse Gaussian elimination by values: which unknown each equation is solved for."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

PIVOT_THRESHOLD = 0.1
"""A pivot is at least this part of the largest eligible entry of its row."""

NEGLIGIBLE = 1e-8
"""An eligible entry below this part of the largest of its row is no pivot while columns are to be avoided."""


@dataclass(frozen=True)
class Pivots:
    """Rows and columns, in order of elimination, whose square block is regular; rows that vanished."""

    rows: np.ndarray
    columns: np.ndarray
    dependent_rows: np.ndarray


def choose_pivots(matrix: sp.csr_array, rows: np.ndarray, avoid: np.ndarray, zero_tolerance: float) -> Pivots:
    """Pivots for `rows` of `matrix`, whose rows and columns are scaled to about one.

    Sparse Gaussian elimination in two passes: first every row that has one is solved for a column outside
    `avoid` (bool per column), then the rest for any column. In a pass the shortest row is next; in it, the
    column with the fewest entries among those not below `PIVOT_THRESHOLD` times the largest. A row whose
    entries all fall below `zero_tolerance` is dependent on those before. Values are used for choosing only.
    Shapes: matrix (n, m), rows (k,), avoid (m,).
    """
    table, members = _tables(matrix, rows)
    pivots = [*_pass(table, members, avoid), *_pass(table, members, np.zeros_like(avoid), zero_tolerance)]
    return Pivots(
        np.array([row for row, _ in pivots], dtype=int),
        np.array([column for _, column in pivots], dtype=int),
        np.array(sorted(table), dtype=int),
    )


def _pass(
    table: dict[int, dict[int, float]],
    members: dict[int, set[int]],
    avoid: np.ndarray,
    zero_tolerance: float | None = None,
) -> list[tuple[int, int]]:
    """Eliminate all rows that have an eligible pivot; `table` and `members` keep what is left.

    Eligible: outside `avoid`, and above `zero_tolerance`, or `NEGLIGIBLE` times the largest where it is None.
    """
    heap = [(len(entries), row) for row, entries in table.items()]
    heapq.heapify(heap)
    chosen: list[tuple[int, int]] = []
    while heap:
        length, row = heapq.heappop(heap)
        if row not in table or length != len(table[row]):
            continue
        smallest = zero_tolerance
        if smallest is None:
            smallest = NEGLIGIBLE * max(map(abs, table[row].values()), default=0.0)
        column = _pivot(table[row], members, avoid, smallest)
        if column is None:
            continue
        entries = table.pop(row)
        for c in entries:
            members[c].discard(row)
        chosen.append((row, column))
        for other in sorted(members.pop(column)):
            _subtract(table[other], entries, column, other, members)
            heapq.heappush(heap, (len(table[other]), other))
    return chosen


def _pivot(
    entries: dict[int, float], members: dict[int, set[int]], avoid: np.ndarray, smallest: float
) -> int | None:
    eligible = {c: abs(v) for c, v in entries.items() if not avoid[c] and abs(v) > smallest}
    if not eligible:
        return None
    limit = PIVOT_THRESHOLD * max(eligible.values())
    return min(
        (c for c, v in eligible.items() if v >= limit), key=lambda c: (len(members[c]), -eligible[c], c)
    )


def _tables(
    matrix: sp.csr_array, rows: np.ndarray
) -> tuple[dict[int, dict[int, float]], dict[int, set[int]]]:
    table: dict[int, dict[int, float]] = {}
    members: dict[int, set[int]] = {}
    for row in rows.tolist():
        span = slice(matrix.indptr[row], matrix.indptr[row + 1])
        values = zip(matrix.indices[span].tolist(), matrix.data[span].tolist(), strict=True)
        table[row] = {column: value for column, value in values if value != 0.0}
        for column in table[row]:
            members.setdefault(column, set()).add(row)
    return table, members


def _subtract(
    target: dict[int, float],
    pivot_row: dict[int, float],
    column: int,
    name: int,
    members: dict[int, set[int]],
) -> None:
    """Eliminate `column` from the row `target`; entries that cancel to rounding are removed."""
    factor = target.pop(column) / pivot_row[column]
    for c, value in pivot_row.items():
        if c == column:
            continue
        old = target.get(c, 0.0)
        new = old - factor * value
        if abs(new) <= 8.0 * np.finfo(float).eps * abs(old):
            target.pop(c, None)
            members[c].discard(name)
        else:
            target[c] = new
            members[c].add(name)
