"""The differentiated equation list: every equation with its derivatives, every unknown with its
derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.model.flat import FlatModel
from daest.systems.aliases import Aliases
from daest.systems.pantelides import Differentiations, Signature, check_structure, differentiations, signature


@dataclass(frozen=True)
class ExpandedSystem:
    """All equations F_i^(k), k ≤ counts.equations[i], in the symbols of the unknowns and their derivatives.

    `z[k]`, `u[k]`, `w[k]` are symbol vectors of the k-th derivatives of the kept unknowns, inputs and noises.
    `rows[e] = (i, k)` says that row e of `residual` is the k-th derivative of kept equation i."""

    flat: FlatModel
    aliases: Aliases
    sigma: Signature
    counts: Differentiations
    z: tuple[ca.SX, ...]
    u: tuple[ca.SX, ...]
    w: tuple[ca.SX, ...]
    rows: tuple[tuple[int, int], ...]
    residual: ca.SX

    @property
    def others(self) -> ca.SX:
        """All symbols but the unknowns: u, u', …, w, w', …, theta, time."""
        return ca.vertcat(*self.u, *self.w, self.flat.theta, self.flat.time)

    def pick(self, positions: list[tuple[int, int]]) -> ca.SX:
        """Column of the symbols of (unknown, order)."""
        return ca.vertcat(ca.SX(0, 1), *(self.z[k][j] for j, k in positions))

    def in_unknowns(self, expression: ca.SX) -> ca.SX:
        """The expression of flat-model symbols (ξ', ξ) in the kept unknowns and their first derivatives."""
        return _substitute_aliases(self.flat, self.aliases, expression, self.z[0], self.z[1])


def expand(
    flat: FlatModel, aliases: Aliases, of: ExpandedSystem | None = None, residual: ca.SX | None = None
) -> ExpandedSystem:
    """Differentiate as often as the structure asks for. With `of`, a system of the same
    model, its equations are replaced by `residual` in the symbols of it. Raises `structurally-singular`."""
    names = [variable.name for variable in aliases.variables]
    if of is None or residual is None:
        z0, z1 = _symbols(names, 0), _symbols(names, 1)
        residual = _substitute_aliases(flat, aliases, flat.residual[aliases.kept_equations.tolist()], z0, z1)
    else:
        z0, z1 = of.z[:2]
    sigma = signature(residual, z1, z0)
    equations = tuple(flat.equations[i] for i in aliases.kept_equations)
    check_structure(sigma, equations, aliases.variables, flat.name)
    counts = differentiations(sigma)
    n_levels = int(counts.unknowns.max(initial=0))
    z = (z0, z1, *(_symbols(names, k) for k in range(2, n_levels + 1)))
    depth = int(counts.equations.max(initial=0))
    u = (flat.u, *(_symbols([v.name for v in flat.inputs], k) for k in range(1, depth + 1)))
    w = (flat.w, *(_symbols([v.name for v in flat.noises], k) for k in range(1, depth + 1)))
    rows, stacked = _differentiate(residual, counts.equations, z, u, w, flat.time)
    return ExpandedSystem(flat, aliases, sigma, counts, z, u, w, rows, stacked)


def _symbols(names: list[str], order: int) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *(ca.SX.sym(derivative_name(name, order)) for name in names))


def derivative_name(name: str, order: int) -> str:
    """`der(der(name))` for order 2."""
    return "der(" * order + name + ")" * order


def _substitute_aliases(flat: FlatModel, aliases: Aliases, expression: ca.SX, z0: ca.SX, z1: ca.SX) -> ca.SX:
    slot, sign = aliases.slot.tolist(), ca.DM(aliases.sign)
    replacements = ca.vertcat(sign * z1[slot, 0], sign * z0[slot, 0])
    return ca.substitute(expression, ca.vertcat(flat.derivatives, flat.xi), replacements)


def _differentiate(
    residual: ca.SX,
    times: np.ndarray,
    z: tuple[ca.SX, ...],
    u: tuple[ca.SX, ...],
    w: tuple[ca.SX, ...],
    t: ca.SX,
) -> tuple[tuple[tuple[int, int], ...], ca.SX]:
    rows = [(i, 0) for i in range(times.size)]
    level, members, parts = residual, np.arange(times.size), [residual]
    for k in range(1, int(times.max(initial=0)) + 1):
        position = np.flatnonzero(times[members] >= k)
        members = members[position]
        argument = ca.vertcat(*z[:-1], *u[:-1], *w[:-1], t)
        rate = ca.vertcat(*z[1:], *u[1:], *w[1:], 1)
        level = ca.jtimes(level[position.tolist()], argument, rate)
        rows += [(int(i), k) for i in members]
        parts.append(level)
    return tuple(rows), ca.vertcat(*parts)
