"""The differentiated equation list of a model: every equation and every unknown with its derivatives, without
aliases (equations `a = b` and `a + b = 0` make several unknowns one); and a point near the start values at
which it holds, where pivots are chosen.

How often an equation must be differentiated is counted as by Pantelides (1988), as canonical offsets of the
signature matrix (Pryce 2001): both give the smallest numbers of differentiations after which the highest
derivatives are matched to the equations. Where they do not exist, the structure is singular, and why is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import lsmr

from daest.errors import ModelError, Place
from daest.lists import first_few
from daest.model.flat import FlatModel
from daest.model.parts import Equation, Variable
from daest.numerics.matching import Defect, canonical_offsets, find_defect
from daest.systems.reduction.algebraic_start import agreed_start

LISTED = 8  # equations or unknowns that a message names before it says how many more there are


@dataclass(frozen=True)
class Signature:
    """Finite entries of the signature matrix: unknown `columns[e]` occurs in equation `rows[e]` with highest
    derivative `orders[e]` (0 or 1). `n` equations and unknowns."""

    rows: np.ndarray
    columns: np.ndarray
    orders: np.ndarray
    n: int

    @property
    def incidence(self) -> sp.csr_array:
        """1 where an unknown occurs in an equation (n, n)."""
        return sp.csr_array((np.ones(self.rows.size), (self.rows, self.columns)), shape=(self.n, self.n))


@dataclass(frozen=True)
class Differentiations:
    """`equations[i]`: how often equation i is differentiated; `unknowns[j]`: highest derivative of unknown j
    then. Degrees of freedom: sum(unknowns) - sum(equations)."""

    equations: np.ndarray
    unknowns: np.ndarray

    @property
    def structural_index(self) -> int:
        """Pryce's structural index: an upper estimate of the differentiation index, exact for most models."""
        deepest = int(self.equations.max(initial=0))
        return deepest + (1 if np.any(self.unknowns == 0) else 0)


def signature(residual: ca.SX, derivatives: ca.SX, unknowns: ca.SX) -> Signature:
    """Signature of residual(derivatives, unknowns, …) with as many rows as unknowns."""
    n = residual.numel()
    plain, differentiated = (_places(residual, symbols) for symbols in (unknowns, derivatives))
    places = np.union1d(plain, differentiated)
    return Signature(places // n, places % n, np.isin(places, differentiated).astype(int), n)


def _places(residual: ca.SX, symbols: ca.SX) -> np.ndarray:
    """Where the symbols occur, as row times their number plus column."""
    rows, columns = ca.jacobian_sparsity(residual, symbols).get_triplet()
    return np.array(rows, dtype=int) * symbols.numel() + np.array(columns, dtype=int)


def differentiations(sigma: Signature) -> Differentiations:
    """Differentiation counts of a structurally regular signature (`check_structure` first)."""
    offsets = canonical_offsets(sigma.rows, sigma.columns, sigma.orders, sigma.n)
    return Differentiations(offsets.rows, offsets.columns)


def check_structure(
    sigma: Signature, equations: tuple[Equation, ...], unknowns: tuple[Variable, ...], model_name: str
) -> None:
    """Raise `structurally-singular` with the equations and unknowns concerned unless all can be matched."""
    defect = find_defect(sigma.incidence)
    if defect is None:
        return
    places = [equations[i].place for i in (*defect.over_rows, *defect.under_rows)]
    raise ModelError(
        "structurally-singular",
        "\n".join(
            [
                f"the equations of {model_name} cannot determine its unknowns",
                *_defect_lines(defect, equations, unknowns),
            ]
        ),
        where=next((place for place in places if place is not None), None),
        remedy="remove one of the equations that compete, and add what fixes the unknowns that nothing "
        "determines: a missing connection, ground or fixed point is the usual reason",
    )


def _defect_lines(
    defect: Defect, equations: tuple[Equation, ...], unknowns: tuple[Variable, ...]
) -> list[str]:
    lines = []
    if defect.over_rows:
        names = name_unknowns(unknowns, defect.over_columns)
        few = f"only {_counted(len(defect.over_columns), 'unknown')} ({names})" if names else "no unknown"
        lines.append(f"{_counted(len(defect.over_rows), 'equation')} for {few}:")
        lines += name_equations(equations, defect.over_rows)
    if defect.under_columns:
        rows = len(defect.under_rows)
        few = f"only {_counted(rows, 'equation')}" if rows else "no equation"
        names = name_unknowns(unknowns, defect.under_columns)
        lines.append(f"{_counted(len(defect.under_columns), 'unknown')} with {few}: {names}")
        lines += name_equations(equations, defect.under_rows)
    return lines


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def name_equations(equations: tuple[Equation, ...], rows: tuple[int, ...]) -> list[str]:
    """One indented line `text  (place)` per equation, at most `LISTED`."""
    lines = [_equation_line(equations[i].text, equations[i].place) for i in rows[:LISTED]]
    if len(rows) > LISTED:
        lines.append(f"    … and {len(rows) - LISTED} more")
    return lines


def _equation_line(text: str, place: Place | None) -> str:
    return f"    {text}" + (f"  ({place})" if place is not None else "")


def name_unknowns(unknowns: tuple[Variable, ...], columns: tuple[int, ...]) -> str:
    """Names, at most `LISTED` of them, separated by commas."""
    return first_few([unknowns[j].name for j in columns], LISTED)


def flat_signature(flat: FlatModel) -> Signature:
    """Signature of the flat model as it stands in the source."""
    return signature(flat.residual, flat.derivatives, flat.xi)


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
        n = self.z[0].numel()
        return entries_of(ca.vertcat(*self.z), [k * n + j for j, k in positions])

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
    u = (flat.u, *(_symbols(flat.input_names, k) for k in range(1, depth + 1)))
    w = (flat.w, *(_symbols(flat.noise_names, k) for k in range(1, depth + 1)))
    rows, stacked = _differentiate(residual, counts.equations, z, u, w, flat.time)
    return ExpandedSystem(flat, aliases, sigma, counts, z, u, w, rows, stacked)


def entries_of(column: ca.SX, positions: list[int]) -> ca.SX:
    """The entries of a column at some positions, as a column."""
    return column[positions] if positions else ca.SX(0, 1)


def _symbols(names: Sequence[str], order: int) -> ca.SX:
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


SELECT_RANK = {"never": 0, "avoid": 1, "default": 2, "prefer": 3, "always": 4, "kept": 5}

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


MANY = 50
"""Entries of a row from which on it is differentiated apart from the others: CasADi takes as many sweeps as
the fullest row, or the fullest column, has entries."""


def sparse_jacobian(expression: ca.SX, symbols: ca.SX) -> ca.SX:
    """∂expression/∂symbols, as `casadi.jacobian`; a flow balance with a thousand currents beside a potential
    that a thousand equations share takes a few sweeps instead of a thousand."""
    counts = np.diff(ca.jacobian_sparsity(expression, symbols).T.colind())
    full = np.flatnonzero(counts >= MANY)
    if full.size == 0:
        return ca.jacobian(expression, symbols)
    rest = np.flatnonzero(counts < MANY)
    order = np.concatenate([rest, full])
    parts = [ca.jacobian(expression[rows.tolist()], symbols) for rows in (rest, full)]
    return ca.vertcat(*parts)[np.argsort(order).tolist(), :]


MAX_STEPS, MAX_HALVINGS = 25, 8
TOLERANCE = 1e-10  # residual relative to the largest term of its linearisation, at which the search stops
GIVEN_WEIGHT = 1e-2  # a given start value moves this much less than one that the model leaves open
DENSE_LIMIT = 400  # equations up to which the least squares steps use a dense factorisation
NUDGE_SEED = 20041101


@dataclass(frozen=True)
class SamplePoint:
    """Values of the unknowns and their derivatives, `z` (n_levels, n), and of `ExpandedSystem.others`."""

    z: np.ndarray
    others: np.ndarray


def sample_point(system: ExpandedSystem) -> SamplePoint:
    """Start values, moved by Gauss-Newton steps onto the equations if they are nonlinear. Where none is
    given, it is the value that follows from the others one by one, else 0.

    A model linear in everything but parameters needs no point: its Jacobian is the same everywhere. If the
    search does not arrive, the start values themselves are returned; the equations are then solved at
    initialisation."""
    start = np.zeros((len(system.z), system.z[0].numel()))
    start[0] = [v.start_or_zero for v in system.aliases.variables]
    point = SamplePoint(start, _other_values(system))
    unknowns = ca.vertcat(*system.z)
    jacobian = sparse_jacobian(system.residual, unknowns)
    if not ca.depends_on(jacobian, ca.vertcat(unknowns, *system.u, *system.w, system.flat.time)):
        return point
    point.z[0] = _agreed(system)
    function = ca.Function("F", [unknowns, system.others], [system.residual, jacobian])
    moved = _project(function, system, point)
    if moved is None and not _is_finite(*_linearised(function, point.z.ravel(), point.others)):
        # A division by an unknown without a start value: a point beside zero tells the structure as well.
        point = nudged(point)
        moved = _project(function, system, point)
    return point if moved is None else moved


def _agreed(system: ExpandedSystem) -> np.ndarray:
    """Values (n,) of kept unknowns: given starts and what follows from them and the inputs, one by one."""
    flat, aliases = system.flat, system.aliases
    own = np.array([v.start_or_zero for v in aliases.variables])
    is_given = np.array([v.start is not None for v in aliases.variables], dtype=bool)
    u = np.array([v.start_or_zero for v in flat.inputs])
    xi = agreed_start(flat, aliases.sign * own[aliases.slot], u, 0.0, is_given[aliases.slot])
    values = xi[aliases.kept_unknowns]
    return np.where(is_given | ~np.isfinite(values), own, values)


def nudged(point: SamplePoint) -> SamplePoint:
    """A generic point nearby, at which entries that vanish by accident of the start values do not vanish."""
    rng = np.random.default_rng(NUDGE_SEED)

    def nudge(values: np.ndarray) -> np.ndarray:
        return values + 0.1 * np.maximum(np.abs(values), 1.0) * rng.uniform(0.5, 1.0, values.shape)

    return SamplePoint(nudge(point.z), point.others)


def _other_values(system: ExpandedSystem) -> np.ndarray:
    inputs = [v.start_or_zero for v in system.flat.inputs]
    n_more = sum(symbols.numel() for symbols in (*system.u[1:], *system.w))
    return np.concatenate([inputs, np.zeros(n_more), system.flat.theta_values, [0.0]])


def _project(function: ca.Function, system: ExpandedSystem, point: SamplePoint) -> SamplePoint | None:
    z = point.z.ravel()
    weight = np.ones_like(point.z)
    weight[0, [v.start is not None for v in system.aliases.variables]] = GIVEN_WEIGHT
    value, jacobian = _linearised(function, z, point.others)
    for _ in range(MAX_STEPS):
        if not _is_finite(value, jacobian):
            return None
        size = np.maximum(abs(jacobian) @ np.maximum(np.abs(z), 1.0), np.finfo(float).tiny)
        if np.all(np.abs(value) <= TOLERANCE * size):
            return SamplePoint(z.reshape(point.z.shape), point.others)
        step = weight.ravel() * _least_squares(jacobian, weight.ravel(), -value)
        for _ in range(MAX_HALVINGS):  # a step out of the domain of a root or a logarithm is too long
            value, jacobian = _linearised(function, z + step, point.others)
            if _is_finite(value, jacobian):
                break
            step = step / 2
        z = z + step
    return None


def _linearised(function: ca.Function, z: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, sp.csr_array]:
    residual, slopes = function(z, others)
    return residual.full().ravel(), sp.csr_array(slopes.sparse())


def _is_finite(value: np.ndarray, jacobian: sp.csr_array) -> bool:
    return bool(np.all(np.isfinite(value)) and np.all(np.isfinite(jacobian.data)))


def _least_squares(jacobian: sp.csr_array, weight: np.ndarray, right: np.ndarray) -> np.ndarray:
    scale = 1.0 / np.maximum(abs(jacobian).max(axis=1).toarray().ravel(), np.finfo(float).tiny)
    weighted = sp.csr_array(sp.diags_array(scale) @ jacobian @ sp.diags_array(weight))
    if right.size <= DENSE_LIMIT:
        return np.linalg.lstsq(weighted.toarray(), scale * right, rcond=None)[0]
    return lsmr(weighted, scale * right)[0]
