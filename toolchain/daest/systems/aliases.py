"""Alias elimination: equations `a = b` and `a + b = 0` make several unknowns one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from daest.model.flat import FlatModel
from daest.model.parts import Variable
from daest.systems.sparse_jacobian import sparse_jacobian

SELECT_RANK = {"never": 0, "avoid": 1, "default": 2, "prefer": 3, "always": 4}

SIZES = (1.0, 1e3, 1e9)  # of the values at which an alias must hold
DIRECTIONS = 2
ROUNDING = 1e-12  # of the largest value


@dataclass(frozen=True)
class Aliases:
    """ξ_i = sign[i] · ξ_{kept_unknowns[slot[i]]}; equations `kept_equations` remain for the unknowns
    `kept_unknowns`.

    `variables` are the kept unknowns, each with the state selection and start value that its group asks
    for."""

    slot: np.ndarray
    sign: np.ndarray
    kept_unknowns: np.ndarray
    kept_equations: np.ndarray
    variables: tuple[Variable, ...]


def find_aliases(flat: FlatModel) -> Aliases:
    """Groups of unknowns that are equal up to sign, by union-find over the alias equations.

    An equation that closes a cycle of aliases stays: after substitution it reads 2 a = 0, or 0 = 0 and then
    the structure check reports it."""
    parent, sign = np.arange(flat.n), np.ones(flat.n)
    removed = []
    for row, first, second, factor in _alias_equations(flat):
        root_a, sign_a = _root(parent, sign, first)
        root_b, sign_b = _root(parent, sign, second)
        if root_a != root_b:
            parent[root_a], sign[root_a] = root_b, sign_a * factor * sign_b
            removed.append(row)
    roots = [_root(parent, sign, i) for i in range(flat.n)]
    return _collect(
        flat, np.array([r for r, _ in roots], dtype=int), np.array([s for _, s in roots]), removed
    )


def _alias_equations(flat: FlatModel) -> list[tuple[int, int, int, float]]:
    """(row, i, j, factor) for every equation that says ξ_i = factor ξ_j with factor ±1 and nothing else."""
    others = ca.vertcat(flat.derivatives, flat.u, flat.w, flat.theta, flat.time)
    mixed = set(ca.jacobian_sparsity(flat.residual, others).get_triplet()[0])
    slopes = sparse_jacobian(flat.residual, flat.xi)
    entries: dict[int, list[tuple[int, Any]]] = {}
    for row, column, value in zip(*slopes.sparsity().get_triplet(), slopes.nonzeros(), strict=True):
        entries.setdefault(row, []).append((column, value))
    points = _probes(flat.n)
    values = _residuals(flat, points)
    rounding = ROUNDING * np.abs(points).max(axis=0)
    found = []
    for row, pair in entries.items():
        if row in mixed or len(pair) != 2:
            continue
        (i, a), (j, b) = pair
        if not (a.is_constant() and b.is_constant() and abs(float(a)) == abs(float(b)) != 0.0):
            continue
        linear = float(a) * points[i] + float(b) * points[j]
        if np.all(np.abs(values[row] - linear) <= rounding):
            found.append((row, i, j, -float(b) / float(a)))
    return sorted(found)


def _probes(n: int) -> np.ndarray:
    """Values of the unknowns (n, m) of either sign and many sizes: a constant slope alone does not tell a
    linear equation from one with a remainder, a floor or a sign in it."""
    directions = np.random.default_rng(0).uniform(-1.0, 1.0, (n, DIRECTIONS))
    return np.hstack(
        [np.zeros((n, 1)), *(size * sign * directions for size in SIZES for sign in (1.0, -1.0))]
    )


def _residuals(flat: FlatModel, points: np.ndarray) -> np.ndarray:
    """Residuals (n, m) at unknowns (n, m), with zero for everything else."""
    residual = ca.Function(
        "residual",
        [flat.xi, flat.derivatives, flat.u, flat.w, flat.theta, flat.time],
        [flat.residual],
    )
    zeros = [0.0] * 5
    return np.column_stack([residual(point, *zeros).full().ravel() for point in points.T])


def _root(parent: np.ndarray, sign: np.ndarray, i: int) -> tuple[int, float]:
    factor = 1.0
    while parent[i] != i:
        factor *= sign[i]
        i = int(parent[i])
    return i, factor


def _collect(flat: FlatModel, root: np.ndarray, sign: np.ndarray, removed: list[int]) -> Aliases:
    groups: dict[int, list[int]] = {}
    for i, r in enumerate(root.tolist()):
        groups.setdefault(r, []).append(i)
    chosen = {r: max(members, key=lambda i: _name_rank(flat.unknowns[i], i)) for r, members in groups.items()}
    kept = np.array(sorted(chosen.values()), dtype=int)
    place = {int(i): k for k, i in enumerate(kept)}
    slot = np.array([place[chosen[int(r)]] for r in root], dtype=int)
    relative = sign * sign[kept[slot]]
    variables = tuple(_merge(flat, int(i), groups[int(root[i])], relative) for i in kept)
    equations = np.setdiff1d(np.arange(flat.n), removed)
    return Aliases(slot, relative, kept, equations, variables)


def _name_rank(variable: Variable, position: int) -> tuple[int, bool, bool, int, int, int]:
    """Larger is the better name for a group: asked for, given a start, least nested, shortest, first."""
    name = variable.name
    return (
        SELECT_RANK[variable.state_select],
        variable.fixed,
        variable.start is not None,
        -name.count("."),
        -len(name),
        -position,
    )


def _merge(flat: FlatModel, kept: int, members: list[int], sign: np.ndarray) -> Variable:
    """The kept variable; what it does not say itself about selection and start it takes from its aliases."""
    own = flat.unknowns[kept]
    by_claim = sorted(members, key=lambda i: (not flat.unknowns[i].fixed, i != kept, i))
    start = next((float(sign[i]) * s for i in by_claim if (s := flat.unknowns[i].start) is not None), None)
    select = max((flat.unknowns[i].state_select for i in members), key=lambda s: SELECT_RANK[s])
    fixed = any(flat.unknowns[i].fixed for i in members)
    return replace(own, start=start, fixed=fixed, state_select=select)
