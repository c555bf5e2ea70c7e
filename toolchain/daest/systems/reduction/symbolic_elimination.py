"""Sparse Gaussian elimination of symbols, with pivots chosen by value."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from daest.numerics.ranks import equilibrated

PIVOT_SHARE = 0.1  # a pivot is at least this share of the largest entry of its row (rows and columns scaled)


def eliminate(matrix: ca.SX, right: ca.SX, values: np.ndarray) -> ca.SX:
    """x with matrix x = right, (n,), valid wherever the pivots do not vanish.

    `values` are those of the matrix at a representative point, where it is regular. Among entries that are
    large enough there the one with the least fill-in is the next pivot (Markowitz 1957)."""
    n = right.numel()
    symbols: list[dict[int, Any]] = [{} for _ in range(n)]
    numbers: list[dict[int, float]] = [{} for _ in range(n)]
    scaled = equilibrated(values)
    for i, j, entry in zip(*matrix.sparsity().get_triplet(), matrix.nonzeros(), strict=True):
        symbols[i][j], numbers[i][j] = entry, float(scaled[i, j])
    rights = list(ca.vertsplit(right))
    open_rows, order = set(range(n)), []
    for _ in range(n):
        row, column = _pivot(numbers, open_rows)
        open_rows.discard(row)
        order.append((row, column))
        for other in open_rows:
            if column in numbers[other]:
                _subtract(symbols, numbers, rights, row, other, column)
    return _back_substitution(symbols, rights, order)


def _pivot(numbers: list[dict[int, float]], open_rows: set[int]) -> tuple[int, int]:
    count: dict[int, int] = {}
    for row in open_rows:
        for column in numbers[row]:
            count[column] = count.get(column, 0) + 1
    candidates = []
    for row in open_rows:
        entries = numbers[row]
        least = PIVOT_SHARE * max(abs(value) for value in entries.values())
        for column, value in entries.items():
            if abs(value) >= least and value != 0.0:
                candidates.append(((len(entries) - 1) * (count[column] - 1), -abs(value), row, column))
    _, _, row, column = min(candidates)
    return row, column


def _subtract(
    symbols: list[dict[int, Any]],
    numbers: list[dict[int, float]],
    rights: list[Any],
    pivot_row: int,
    row: int,
    column: int,
) -> None:
    """Remove `column` from `row` by subtracting a multiple of the pivot row."""
    factor = symbols[row].pop(column) / symbols[pivot_row][column]
    multiple = numbers[row].pop(column) / numbers[pivot_row][column]
    for j, entry in symbols[pivot_row].items():
        if j != column:
            symbols[row][j] = symbols[row].get(j, 0) - factor * entry
            numbers[row][j] = numbers[row].get(j, 0.0) - multiple * numbers[pivot_row][j]
    rights[row] = rights[row] - factor * rights[pivot_row]


def _back_substitution(
    symbols: list[dict[int, Any]], rights: list[Any], order: list[tuple[int, int]]
) -> ca.SX:
    solution: dict[int, Any] = {}
    for row, column in reversed(order):
        total = rights[row]
        for j, entry in symbols[row].items():
            if j != column:
                total = total - entry * solution[j]
        solution[column] = total / symbols[row][column]
    return ca.vertcat(*(solution[j] for j in range(len(order))))
