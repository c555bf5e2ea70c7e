"""Rows of the inverse of a large pencil that are multiples of each other, told from its equations.

Row i of (sE - J) (sE - J)⁻¹ = I says that the rows of the inverse, weighted with the entries of that
equation, add up to the i-th unit row. Where an equation contains two unknowns alone, both differentiated or
both not (`a.phi = b.phi`, `a.tau + b.tau = 0`), their rows are therefore multiples of each other in every
coefficient of s, s², …; where it contains one, its row is zero there. Connections and aliases are such
equations, and make most of a large model. For columns, the transposed pencil says the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from daest.numerics.sparse_columns import pencil_entries

CANCELLED = 1e-8
"""Coefficients of one group that add up to less than this part of the largest say nothing."""

LARGEST_FACTOR = 1e100
"""Rows are no group where one would be more than this times another: a long train of gears."""


@dataclass(frozen=True)
class Proportions:
    """Row j is factor[j] times row representatives[group[j]], |factor| ≤ 1; zero where group[j] is -1."""

    group: np.ndarray
    factor: np.ndarray
    representatives: np.ndarray


@dataclass(frozen=True)
class _Entries:
    """Entries of sE - J, all zeros left out; `is_mixed` (n,) marks rows with an entry a s + b."""

    row: np.ndarray
    column: np.ndarray
    power: np.ndarray
    value: np.ndarray
    is_mixed: np.ndarray


def proportional_rows(E: sp.csr_array, J: sp.csr_array) -> Proportions:
    """Groups of rows of the coefficients of s^m, m ≥ 1, of (sE - J)⁻¹: those that equations of one or two
    unknowns tell, with groups in place of unknowns again and again. Shapes: E and J (n, n)."""
    entries = _entries(E, J)
    n = E.shape[0]
    group, factor = np.arange(n), np.ones(n)
    while True:
        single, pairs = _short_equations(entries, group, factor)
        shared, weight = _joined(n, pairs)
        shared[single] = -1
        if np.array_equal(shared, np.arange(n)):
            return _from_largest(group, factor)
        known = group >= 0
        factor[known] *= weight[group[known]]
        group[known] = shared[group[known]]
        factor[group < 0] = 0.0


def _entries(E: sp.csr_array, J: sp.csr_array) -> _Entries:
    row, column, power, value = pencil_entries(E, J)
    both = sp.coo_array(sp.csr_array((np.ones(row.size), (row, column)), shape=E.shape))
    is_mixed = np.zeros(E.shape[0], dtype=bool)
    is_mixed[both.coords[0][both.data > 1.0]] = True
    return _Entries(row, column, power, value, is_mixed)


def _short_equations(
    entries: _Entries, group: np.ndarray, factor: np.ndarray
) -> tuple[np.ndarray, list[tuple[int, int, float]]]:
    """Groups that are zero, and pairs (g, h, r) with rows h = r · rows g, of two groups that are not."""
    own = group[entries.column]
    silent = entries.is_mixed.copy()
    silent[entries.row[(own < 0) & (entries.power == 1)]] = True  # s times a constant is no power of s alone
    used = own >= 0
    # Sparse matrices count in 32 bits, which these numbers exceed from 46 341 equations on.
    key = (entries.row[used].astype(np.int64) * group.size + own[used]) * 2 + entries.power[used]
    value = entries.value[used] * factor[entries.column[used]]
    key, place = np.unique(key, return_inverse=True)
    total = np.bincount(place, value, minlength=key.size)
    silent[(key // (2 * group.size))[np.abs(total) <= CANCELLED * np.bincount(place, np.abs(value))]] = True
    row, own, power = key // (2 * group.size), key // 2 % group.size, key % 2
    first = np.flatnonzero(np.diff(row, prepend=-1))
    counts = np.diff(np.append(first, row.size))
    told = ~silent[row[first]]
    single = np.unique(own[first[told & (counts == 1)]])
    a = first[told & (counts == 2)]
    a = a[(power[a] == power[a + 1]) & (own[a] != own[a + 1])]
    ratios = -total[a] / total[a + 1]
    return single, list(zip(own[a].tolist(), own[a + 1].tolist(), ratios.tolist(), strict=True))


def _joined(n: int, pairs: list[tuple[int, int, float]]) -> tuple[np.ndarray, np.ndarray]:
    """The first member of the set that each of n groups is joined to, and its factor to that one."""
    neighbours: dict[int, list[tuple[int, float]]] = {}
    for g, h, ratio in pairs:
        neighbours.setdefault(g, []).append((h, ratio))
        neighbours.setdefault(h, []).append((g, 1.0 / ratio))
    shared, weight, seen = np.arange(n), np.ones(n), set()
    for start in neighbours:
        if start in seen:
            continue
        seen.add(start)
        waiting = [start]
        while waiting:
            g = waiting.pop()
            for h, ratio in neighbours[g]:
                size = weight[g] * ratio
                if h not in seen and 1.0 / LARGEST_FACTOR < abs(size) < LARGEST_FACTOR:
                    seen.add(h)
                    waiting.append(h)
                    shared[h], weight[h] = start, size
    return shared, weight


def _from_largest(group: np.ndarray, factor: np.ndarray) -> Proportions:
    """Groups numbered by their first member, factors relative to the largest of each."""
    used = np.flatnonzero(group >= 0)
    _, number = np.unique(group[used], return_inverse=True)
    order = np.lexsort((-np.abs(factor[used]), number))
    representatives = used[order[np.flatnonzero(np.diff(number[order], prepend=-1))]]
    group, relative = np.full(group.size, -1), np.zeros(group.size)
    group[used] = number
    relative[used] = factor[used] / factor[representatives[number]]
    return Proportions(group, relative, representatives)
