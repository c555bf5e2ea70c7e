"""Which variables become states, decided at a sample point.

Choice of states: which derivatives of a differentiated system become plain unknowns (dummy derivatives).

Mattsson & Söderlind, SIAM J. Sci. Comput. 14 (1993): per stage, as many highest derivatives as there are
differentiated equations, so that the Jacobian of these equations in them is regular.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.linalg.lapack import dgecon, dgetrf
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching

from daest.errors import ModelError
from daest.numerics.ranks import equilibrated
from daest.systems.reduction.expand import (
    SELECT_RANK,
    ExpandedSystem,
    SamplePoint,
    name_equations,
    nudged,
    sparse_jacobian,
)

WELL_CONDITIONED = 1e-6  # estimated reciprocal condition above which a block is regular beyond doubt
MOST_PLACES = 256  # sizes of alias groups beyond this are not told apart


@dataclass(frozen=True)
class StateChoice:
    """`dummies[j]`: how many derivatives of kept unknown j are plain unknowns beside its highest one."""

    dummies: np.ndarray
    highest: np.ndarray

    @property
    def states(self) -> list[tuple[int, int]]:
        """(unknown, order) of every state."""
        kept = (self.highest - self.dummies).tolist()
        return [(j, k) for j, count in enumerate(kept) for k in range(count)]

    @property
    def solved(self) -> list[tuple[int, int]]:
        """(unknown, order) of everything that the equations determine from the states."""
        kept = (self.highest - self.dummies).tolist()
        return [(j, k) for j, count in enumerate(kept) for k in range(count, int(self.highest[j]) + 1)]


def choose_states(system: ExpandedSystem, point: SamplePoint) -> StateChoice:
    """Dummy derivatives at the sample point; for a varying Jacobian that is singular there, at a generic one
    nearby. Raises ModelError where the equations do not determine the highest derivatives."""
    counts, leading = system.counts, leading_jacobian(system)
    rank = _state_rank(system)

    def counted(at: SamplePoint, pivot: float) -> StateChoice:
        dummies = dummy_counts(leading.at(at), counts.equations, counts.unknowns, rank, pivot)
        return StateChoice(dummies, counts.unknowns)

    try:
        if not leading.is_varying:
            return counted(point, PIVOT_CONSTANT)
        try:
            return counted(point, PIVOT_VARYING)
        except DependentEquations:
            return counted(nudged(point), PIVOT_VARYING)
    except DependentEquations as error:
        raise singular_after_reduction(system, [(i, 0) for i in error.rows]) from error


@dataclass(frozen=True)
class LeadingJacobian:
    """Jacobian of the differentiated equations in the highest derivatives; `is_varying`: by more than
    parameters.

    ∂F_i^(c_i)/∂ξ_j^(d_j) = ∂F_i/∂ξ_j^(d_j - c_i), so that the undifferentiated equations suffice: `rows` and
    `columns` place the entries that `entries` returns."""

    entries: ca.Function
    rows: np.ndarray
    columns: np.ndarray
    n: int
    is_varying: bool

    def at(self, point: SamplePoint) -> sp.csr_array:
        """Its value (n, n) at a point."""
        values = self.entries(point.z.ravel(), point.others).full().ravel()
        return sp.csr_array((values, (self.rows, self.columns)), shape=(self.n, self.n))


def leading_jacobian(system: ExpandedSystem) -> LeadingJacobian:
    n, counts = system.sigma.n, system.counts
    rows, columns = np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    entries: list[Any] = []
    for order, symbols in enumerate(system.z[:2]):
        jacobian = sparse_jacobian(system.residual[:n], symbols)
        i, j = (np.array(part, dtype=int) for part in jacobian.sparsity().get_triplet())
        leads = np.flatnonzero(counts.unknowns[j] - counts.equations[i] == order)
        nonzeros = jacobian.nonzeros()
        rows, columns = np.concatenate([rows, i[leads]]), np.concatenate([columns, j[leads]])
        entries += [nonzeros[e] for e in leads]
    unknowns, stacked = ca.vertcat(*system.z), ca.vertcat(ca.SX(0, 1), *entries)
    is_varying = ca.depends_on(stacked, ca.vertcat(unknowns, *system.u, *system.w, system.flat.time))
    function = ca.Function("leading", [unknowns, system.others], [stacked])
    return LeadingJacobian(function, rows, columns, n, is_varying)


def depends_on_place(system: ExpandedSystem, choice: StateChoice) -> bool:
    """Whether the constraints are solved for the dummy derivatives with coefficients that vary with the
    state, so that the choice may become singular on the way.

    Solved one after the other, as orientations along a chain of joints, only the coefficients within a loop
    decide: the determinant is the product of those of the loops."""
    leading = leading_jacobian(system)
    coefficients = leading.entries(ca.vertcat(*system.z), system.others)
    moving = ca.vertcat(*system.z, *system.u, *system.w, system.flat.time)
    for level in range(1, int(np.max(choice.dummies, initial=0)) + 1):
        constrained = system.counts.equations[leading.rows] >= level
        solved = np.flatnonzero(constrained & (choice.dummies[leading.columns] >= level))
        inside = solved[_within_loops(leading.rows[solved], leading.columns[solved])]
        if inside.size and ca.depends_on(coefficients[inside.tolist()], moving):
            return True
    return False


def _within_loops(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Which entries (n,) of a square matrix lie in the diagonal blocks of its block triangular form; all of
    them where no permutation has a full diagonal."""
    _, row = np.unique(rows, return_inverse=True)
    _, column = np.unique(columns, return_inverse=True)
    shape = (int(np.max(row, initial=-1)) + 1, int(np.max(column, initial=-1)) + 1)
    everywhere = np.ones(rows.size, dtype=bool)
    if shape[0] != shape[1] or not rows.size:
        return everywhere
    pattern = sp.csr_array((np.ones(rows.size), (row, column)), shape=shape)
    owner = maximum_bipartite_matching(pattern, perm_type="row")  # of every column its row
    if np.any(owner < 0):
        return everywhere
    follows = sp.csr_array((np.ones(rows.size), (row, owner[column])), shape=shape)
    block = connected_components(follows, connection="strong")[1]
    return np.asarray(block[row] == block[owner[column]])


def _state_rank(system: ExpandedSystem) -> np.ndarray:
    """Wish to keep der^o(ξ_j) as a state, (n_levels, n) integers, larger is stronger.

    Never-states come last, then derivatives that are no variable of their own; among variables the model's
    stateSelect decides, then whether the model differentiates it, a fixed start, a start, and in how many
    connectors it, or the variable whose derivative it is, occurs: absolute coordinates before relative
    ones."""
    variables = system.aliases.variables
    differentiated = np.zeros(len(variables), dtype=bool)
    differentiated[system.sigma.columns[system.sigma.orders == 1]] = True
    places = _shared_places(system)
    rank = np.zeros((len(system.z), len(variables)), dtype=int)
    for j, variable in enumerate(variables):
        claims = 4 * differentiated[j] + 2 * variable.fixed + (variable.start is not None)
        value = MOST_PLACES * (8 * SELECT_RANK[variable.state_select] + claims) + places[j]
        is_never = variable.state_select == "never"
        rank[0, j] = 0 if is_never else 2 + value
        rank[1:, j] = 0 if is_never else 1
    return rank


def _shared_places(system: ExpandedSystem) -> np.ndarray:
    """Size of every unknown's alias group, or of the group that it is the derivative of if that is larger."""
    size = np.bincount(system.aliases.slot, minlength=system.sigma.n)
    sigma = system.sigma
    n_entries = np.bincount(sigma.rows, minlength=sigma.n)
    entries = list(zip(sigma.rows.tolist(), sigma.columns.tolist(), sigma.orders.tolist(), strict=True))
    plain = {i: j for i, j, order in entries if order == 0}
    for i, j, order in entries:
        if order == 1 and n_entries[i] == 2 and i in plain:
            size[plain[i]] = max(size[plain[i]], size[j])
    return np.minimum(size, MOST_PLACES - 1)


def singular_after_reduction(system: ExpandedSystem, rows: list[tuple[int, int]]) -> ModelError:
    """The error for equations `rows` (kept equation, order) that depend on each other."""
    own = tuple(sorted({int(system.aliases.kept_equations[i]) for i, _ in rows}))
    equations = system.flat.equations
    return ModelError(
        "singular-after-reduction",
        "\n".join(
            [
                f"each equation of {system.flat.name} can be matched to an unknown, but these (or their time "
                "derivatives) depend on each other for the present parameter and start values, so that some "
                "unknowns stay free:",
                *name_equations(equations, own),
            ]
        ),
        where=next((equations[i].place for i in own if equations[i].place is not None), None),
        remedy="look for two paths that impose the same constraint (parallel rigid connections, two grounds, "
        "a closed kinematic loop) and for parameters that are zero, and put an elasticity, a resistance or a "
        "value there",
    )


# A dummy derivative of low preference is taken while its pivot, relative to its equation, is at least this.
PIVOT_CONSTANT = 1e-4  # coefficients do not change with the state: only rounding counts
PIVOT_VARYING = 0.3  # they do: keep away from the configuration in which the pivot vanishes
# Pivots closer than this are equal: the later variable becomes the dummy, the earlier one the state.
PIVOT_TIE = 1e-6


# Wishes from here on are those of variables that are to be states, whatever their units make of a pivot.
ALWAYS = MOST_PLACES * 8 * SELECT_RANK["always"]


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
    n_rows, n_columns = block.shape
    entries = sp.coo_array(block)
    nodes = (entries.coords[0], n_rows + entries.coords[1])
    graph = sp.csr_array((np.ones(entries.nnz), nodes), shape=(n_rows + n_columns, n_rows + n_columns))
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
    any. Columns that are to be states come after all others: the pivot of a torque beside a speed is small
    where the damper between them is, and that of a pressure beside a level where it counts in Pa."""
    remaining = block / np.maximum(np.abs(block).max(axis=1, keepdims=True), np.finfo(float).tiny)
    smallest = max(block.shape) * np.finfo(float).eps * max(1.0, np.linalg.norm(remaining))
    picked: list[int] = []
    for threshold in (pivot, smallest):
        for value in np.unique(wish if threshold == smallest else wish[wish < ALWAYS]):
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
    """The rows that make a square block singular (empty where it is regular), units scaled out. Shapes: block
    (n, n); rows (k,)."""
    scaled = equilibrated(block)
    return np.zeros(0, dtype=int) if _is_regular(scaled) else _dependent_rows(scaled)


def _is_regular(block: np.ndarray) -> bool:
    """Whether a square block (n, n) is far from singular, as its factors tell: in a small part of the time
    that singular values take."""
    factors, _, status = dgetrf(block)
    if status:
        return False
    reciprocal_condition, status = dgecon(factors, np.linalg.norm(block, 1))
    return bool(not status and reciprocal_condition > WELL_CONDITIONED)
