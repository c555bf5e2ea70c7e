"""Standard form of large models, sparse from end to end: dynamic part and maps to differentiated signals.

(sE - J)⁻¹ = Q1 (sI - A)⁻¹ P1 + Σ maps[i] s^i: the coefficients of s^i are those of `numerics.laurent`, and
that of s⁻¹ is Q1 P1, from which z1 is chosen among the unknowns that occur differentiated. Orthonormal bases
of z2, which are what is dense in the form of `systems.split`, are never made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from daest.errors import NumericalError
from daest.model.linear import GroupedMatrix, LinearDAE, RankDecision, SparseForm
from daest.numerics.laurent import (
    Expansion,
    apply_inverse,
    expand_at_infinity,
    inverse_columns,
    inverse_rows,
    sparse_system,
)
from daest.numerics.pencils import Scaling, apply_scaling, unit_scaling
from daest.numerics.proportional import proportional_rows
from daest.numerics.sparse_basis import independent_block
from daest.numerics.sparse_columns import scaled as in_units
from daest.numerics.sparse_columns import ungrouped

NEGLIGIBLE = 1e-12
"""Part of the largest entry of its row or column up to which an entry of Q1 or A is a rounding error."""

SKETCHED = 4
"""From so many derivatives for each finite mode on, the finite subspace is found from random combinations."""

SPARE = 8
"""Combinations beyond the number of finite modes: one alone may happen to be nearly dependent on others."""


@dataclass(frozen=True)
class ScaledExpansion:
    """The expansion of the pencil scaled by powers of two: coefficients of s^m in the units of the model are
    columns · part · rows / time^m."""

    scaling: Scaling
    expansion: Expansion
    E: sp.csr_array
    J: sp.csr_array


def scaled_expansion(dae: LinearDAE, tolerance: float | None = None) -> ScaledExpansion:
    """Raises NumericalError `system-jacobian-singular` where values cancel what the structure promises."""
    E, J = sp.csr_array(dae.E), sp.csr_array(dae.J)
    scaling = unit_scaling(E, J)
    E, J = apply_scaling(scaling, E, J)
    return ScaledExpansion(scaling, expand_at_infinity(E, J, tolerance), E, J)


def sparse_form(dae: LinearDAE, tolerance: float | None = None) -> SparseForm:
    """The sparse standard form. Raises NumericalError `system-jacobian-singular`."""
    scaled = scaled_expansion(dae, tolerance)
    states, P1, Q1 = _dynamic(scaled)
    A = _without_rounding(P1 @ scaled.J @ Q1)
    maps, decisions = _differentiated(scaled, tolerance)
    maps = [_direct(scaled, dae), *maps] if dae.n > states.size else []
    rows, columns, time = (
        sp.diags_array(scaled.scaling.rows),
        scaled.scaling.columns,
        scaled.scaling.time,
    )
    own = columns[states]
    return SparseForm(
        states=states,
        left_dynamic=sp.csr_array(sp.diags_array(own * time) @ P1 @ rows),
        right_dynamic=sp.csr_array(sp.diags_array(columns) @ Q1 @ sp.diags_array(1.0 / own)),
        A=sp.csr_array(sp.diags_array(own * time) @ A @ sp.diags_array(1.0 / own)),
        maps=tuple(maps),
        index=len(maps),
        decisions=(scaled.expansion.decision, *decisions),
    )


def _differentiated(
    scaled: ScaledExpansion, tolerance: float | None
) -> tuple[list[GroupedMatrix], list[RankDecision]]:
    """Coefficients of s, s², … up to the highest that is not zero, and the decisions on that."""
    expansion, scaling = scaled.expansion, scaled.scaling
    rows = proportional_rows(scaled.E, scaled.J)
    columns = proportional_rows(sp.csr_array(scaled.E.T), sp.csr_array(scaled.J.T))
    powers = range(1, expansion.highest_power + 1)
    wanted = np.flatnonzero(expansion.rows[columns.representatives] > 0)
    found = inverse_columns(expansion, columns.representatives[wanted], powers, rows.representatives)
    sizes = {m: float(abs(part).max()) if part.nnz else 0.0 for m, part in found.items()}
    threshold = (NEGLIGIBLE if tolerance is None else tolerance) * max(sizes.values(), default=0.0)
    decisions = [
        RankDecision(f"largest coefficient of s^{m}", (size,), threshold, int(size > threshold), float("inf"))
        for m, size in sizes.items()
    ]
    last = max((m for m in powers if sizes[m] > threshold), default=0)
    place = np.full(columns.representatives.size + 1, -1)
    place[wanted] = np.arange(wanted.size)
    maps = [
        GroupedMatrix(
            core=found[m],
            row_group=rows.group,
            row_factor=rows.factor * scaling.columns / scaling.time**m,
            column_group=place[columns.group],
            column_factor=columns.factor * scaling.rows,
        )
        for m in range(1, last + 1)
    ]
    return maps, decisions


def _spread(part: sp.csc_array, columns: np.ndarray, n: int) -> sp.csc_array:
    """The columns at their places (increasing) in a matrix of n columns, without a copy of the entries."""
    counts = np.zeros(n, dtype=np.int64)
    counts[columns] = np.diff(part.indptr)
    pointers = np.concatenate([[0], np.cumsum(counts)])
    return sp.csc_array((part.data, part.indices, pointers), shape=(part.shape[0], n))


def _direct(scaled: ScaledExpansion, dae: LinearDAE) -> GroupedMatrix:
    """Coefficient of s⁰: rows of unknowns in outputs, columns of equations with inputs, noises or offsets."""
    n = dae.n
    seen = np.flatnonzero(np.any(dae.C != 0.0, axis=0))
    used = np.flatnonzero(np.any(dae.K != 0.0, axis=1) | np.any(dae.B != 0.0, axis=1) | (dae.offset != 0.0))
    columns = _spread(inverse_columns(scaled.expansion, used, [0])[0], used, n)
    rows = inverse_rows(scaled.expansion, seen, [0])[0]
    others = np.ones(n)
    others[used] = 0.0
    by_row = _spread(sp.csc_array((rows @ sp.diags_array(others)).T), seen, n).T
    return ungrouped(in_units(sp.csc_array(columns + by_row), scaled.scaling.columns, scaled.scaling.rows))


def _dynamic(scaled: ScaledExpansion) -> tuple[np.ndarray, sp.csr_array, sp.csr_array]:
    """(states, P1, Q1) of the scaled pencil, Q1 with an identity in the rows `states`."""
    expansion, E = scaled.expansion, scaled.E
    n, degree = E.shape[0], expansion.degree
    if degree == 0:
        return np.empty(0, dtype=int), sp.csr_array((0, n)), sp.csr_array((n, 0))
    rates = np.flatnonzero(np.diff(sp.csc_array(E).indptr) > 0)
    span = _finite_subspace(expansion, E, rates)
    picked, opposite = independent_block(sp.csr_array(span[rates]))
    if picked.size != degree:
        raise NumericalError(
            "system-jacobian-singular",
            f"The structure tells of {degree} finite modes, the values of {picked.size}.",
            remedy="Check the parameters for values many orders of magnitude too large or too small.",
        )
    order = np.argsort(rates[picked])
    states, opposite = rates[picked][order], opposite[order]
    span = sp.csc_array(span[:, opposite])
    # Q1 = span · (span in the rows of the states)⁻¹, solved for as the transposed system
    system = sparse_system(sp.csr_array(span.T[:, states]), np.arange(degree))
    Q1 = _without_rounding(sp.csr_array(system.solve(sp.csc_array(span.T)).T))
    return states, inverse_rows(expansion, states, [-1])[-1], Q1


def _finite_subspace(expansion: Expansion, E: sp.csr_array, rates: np.ndarray) -> sp.csr_array:
    """Columns (n, …) that span the finite subspace: those of the projector Q1 P1 E at `rates`, or, where its
    rank is a small part of them, as many combinations of these as the rank (and `SPARE`)."""
    degree = expansion.degree
    if SKETCHED * degree >= rates.size:
        equations = np.flatnonzero(np.diff(E.indptr) > 0)
        residues = inverse_columns(expansion, equations, [-1])[-1]
        return sp.csr_array(residues @ E[equations][:, rates])
    mixed = np.random.default_rng(0).standard_normal((rates.size, degree + SPARE))
    return sp.csr_array(apply_inverse(expansion, E[:, rates] @ mixed, -1))


def _without_rounding(matrix: sp.csr_array) -> sp.csr_array:
    """The matrix without entries below `NEGLIGIBLE` times the largest of their row."""
    entries = sp.coo_array(matrix)
    largest = abs(sp.csr_array(matrix)).max(axis=1).toarray().ravel()
    kept = np.abs(entries.data) > NEGLIGIBLE * largest[entries.coords[0]]
    row, column = entries.coords
    return sp.csr_array((entries.data[kept], (row[kept], column[kept])), shape=matrix.shape)
