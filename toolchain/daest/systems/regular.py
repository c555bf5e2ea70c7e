"""Equations whose highest derivatives depend on each other in a way that structure does not see.

Two capacitors between the same nodes, written as C der(v1) - C der(v2) = … and C der(v2) - C der(v1) = …,
have a derivative in each equation, but their sum has none: it is a constraint. Where the Jacobian of the
differentiated equations in the highest derivatives is singular for almost every point and parameter, one
equation is replaced by the combination in which these derivatives cancel (the linear combination method of
Tan, Nedialkov & Pryce, Computers and Mathematics with Applications 74, 2017), until none is left. The
coefficients are exact expressions of parameters.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from daest.errors import ModelError
from daest.model.flat import FlatModel
from daest.numerics.matching import block_triangular, maximum_matching
from daest.systems.expand import ExpandedSystem, SamplePoint, expand, find_aliases
from daest.systems.state_choice import LeadingJacobian, dependent_rows, leading_jacobian
from daest.systems.symbolic_elimination import eliminate

POINTS = 2
SEED = 20170601
SUPPORT = 1e-9
"""Share of the largest weight of a combination below which an equation takes no part in it."""
CANCELLED = 1e-10
"""What is left of a derivative's coefficient, relative to its terms, when it cancels."""


def regular_system(flat: FlatModel) -> ExpandedSystem:
    """The differentiated equations of the model, with the highest derivatives independent for almost every
    point if combinations with parameters as coefficients can make them so. Raises `structurally-singular`."""
    aliases = find_aliases(flat)
    system = expand(flat, aliases)
    for _ in range(system.sigma.n):
        residual = _combined(system)
        if residual is None:
            break
        try:
            system = expand(flat, aliases, system, residual)
        except ModelError:  # the combination says nothing: the model itself is at fault, and is told as such
            break
    return system


def _combined(system: ExpandedSystem) -> ca.SX | None:
    """The equations with one of them replaced by a combination without its highest derivatives; None where
    these are independent, or no such combination is found."""
    leading = leading_jacobian(system)
    points = [_generic_point(system, seed) for seed in range(SEED, SEED + POINTS)]
    values = [leading.at(point) for point in points]
    block = _dependent_block(values)
    if block is None:
        return None
    support, columns = _combination(values[0], block)
    if support.size < 2 or np.ptp(system.counts.equations[support]) > 0:
        return None
    return _replaced(system, leading, support, columns, points)


def _generic_point(system: ExpandedSystem, seed: int) -> SamplePoint:
    """Near the start values, at parameters near those of the model, none of them zero."""
    rng = np.random.default_rng(seed)

    def moved(values: np.ndarray) -> np.ndarray:
        return values + 0.1 * np.where(values == 0.0, 1.0, np.abs(values)) * rng.uniform(
            0.5, 1.0, values.shape
        )

    start = np.zeros((len(system.z), system.sigma.n))
    start[0] = [0.0 if v.start is None else v.start for v in system.aliases.variables]
    others = np.zeros(system.others.numel())
    n_theta = len(system.flat.parameters)
    others[others.size - 1 - n_theta : others.size - 1] = system.flat.theta_values
    return SamplePoint(moved(start), moved(others))


def _dependent_block(values: list[sp.csr_array]) -> np.ndarray | None:
    """Rows of a diagonal block that is singular at every point."""
    pattern = values[0]
    column_of = maximum_matching(pattern)
    if np.any(column_of < 0):
        return None
    for rows, columns in block_triangular(pattern, column_of):
        if rows.size > 1:
            dense = [value[rows][:, columns].toarray() for value in values]
            if all(np.all(np.isfinite(d)) and dependent_rows(d).size for d in dense):
                return rows
    return None


def _combination(values: sp.csr_array, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the sparsest combination that vanishes, and the columns in which they have entries."""
    graph = sp.block_array([[None, values], [values.T, None]])
    label = connected_components(graph, directed=False)[1]
    n = values.shape[0]
    rows = np.flatnonzero(label[:n] == label[block[0]])
    dense = values[rows].toarray()
    dense = dense / np.maximum(np.abs(dense).max(axis=1, keepdims=True), np.finfo(float).tiny)
    null = scipy.linalg.null_space(dense.T).T
    if null.shape[0] == 0:
        return rows[:0], rows[:0]
    # Reduced to an identity in some of the rows, the combinations are as sparse as they can simply be made.
    pivots = scipy.linalg.qr(null, mode="r", pivoting=True)[1][: null.shape[0]]
    reduced = np.linalg.solve(null[:, pivots], null)
    taking = np.abs(reduced) > SUPPORT * np.abs(reduced).max(axis=1, keepdims=True)
    support = rows[taking[np.argmin(taking.sum(axis=1))]]
    return support, np.unique(values[support].indices)


def _replaced(
    system: ExpandedSystem,
    leading: LeadingJacobian,
    support: np.ndarray,
    columns: np.ndarray,
    points: list[SamplePoint],
) -> ca.SX | None:
    """The last equation of the support plus multiples of the others, without derivatives in `columns`."""
    *others, row = support.tolist()
    entries = _symbolic_entries(system, leading, support, columns)
    if ca.depends_on(entries, ca.vertcat(*system.z, *system.u, *system.w, system.flat.time)):
        return None
    numbers = leading.at(points[0])[support][:, columns].toarray()
    chosen = np.sort(scipy.linalg.qr(numbers[:-1], mode="r", pivoting=True)[1][: len(others)])
    matrix, right = entries[:-1, chosen.tolist()].T, entries[-1, chosen.tolist()].T
    weights = eliminate(ca.sparsify(matrix), right, numbers[:-1, chosen].T)
    residual = ca.SX(system.residual[: system.sigma.n])
    combined = residual[row] - ca.dot(weights, residual[others])
    orders = system.counts.unknowns[columns] - system.counts.equations[row]
    gone = system.pick([(int(j), int(k)) for j, k in zip(columns, orders, strict=True) if k in (0, 1)])
    if not _cancels(system, combined, residual[support.tolist()], gone, points):
        return None
    residual[row] = ca.substitute(combined, gone, ca.SX.zeros(gone.numel()))
    return residual


def _symbolic_entries(
    system: ExpandedSystem, leading: LeadingJacobian, rows: np.ndarray, columns: np.ndarray
) -> ca.SX:
    """The leading Jacobian (n_rows, n_columns) in these rows and columns."""
    every: Any = leading.entries(ca.vertcat(*system.z), system.others)
    place = {int(row): i for i, row in enumerate(rows)}
    column_place = {int(column): j for j, column in enumerate(columns)}
    matrix = ca.SX(rows.size, columns.size)
    for entry, (i, j) in enumerate(zip(leading.rows.tolist(), leading.columns.tolist(), strict=True)):
        if i in place:
            matrix[place[i], column_place[j]] = every[entry]
    return matrix


def _cancels(
    system: ExpandedSystem, combined: ca.SX, terms: ca.SX, gone: ca.SX, points: list[SamplePoint]
) -> bool:
    """Whether the combination does not depend on the symbols `gone`, but for rounding."""
    slopes = ca.Function(
        "slopes",
        [ca.vertcat(*system.z), system.others],
        [ca.densify(ca.jacobian(combined, gone)), ca.densify(ca.jacobian(terms, gone))],
    )
    for point in points:
        left, own = (np.abs(part.full()) for part in slopes(point.z.ravel(), point.others))
        if not np.all(left.ravel() <= CANCELLED * np.maximum(own.max(axis=0), np.finfo(float).tiny)):
            return False
    return True
