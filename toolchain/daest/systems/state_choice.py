"""Which variables become states, decided at a sample point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.errors import ModelError
from daest.systems.aliases import SELECT_RANK
from daest.systems.dummy_derivatives import PIVOT_CONSTANT, PIVOT_VARYING, DependentEquations, dummy_counts
from daest.systems.expand import ExpandedSystem
from daest.systems.pantelides import name_equations
from daest.systems.sample_point import SamplePoint, nudged
from daest.systems.sparse_jacobian import sparse_jacobian

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
    nearby."""
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
    state, so that the choice may become singular on the way."""
    leading = leading_jacobian(system)
    constrained = system.counts.equations[leading.rows] >= 1
    solved = np.flatnonzero(constrained & (choice.dummies[leading.columns] >= 1))
    coefficients = leading.entries(ca.vertcat(*system.z), system.others)[solved.tolist()]
    moving = ca.vertcat(*system.z, *system.u, *system.w, system.flat.time)
    return bool(solved.size) and ca.depends_on(coefficients, moving)


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
