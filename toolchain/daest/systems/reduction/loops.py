"""Solve the blocks of a differentiated system one after the other, symbolically where that is possible.

Some equations have highest derivatives that depend on each other in a way that structure does not see. Two
capacitors between the same nodes, written as C der(v1) - C der(v2) = … and C der(v2) - C der(v1) = …, have a
derivative in each equation, but their sum has none: it is a constraint. Where the Jacobian of the
differentiated equations in the highest derivatives is singular for almost every point and parameter, one
equation is replaced by the combination in which these derivatives cancel (the linear combination method of
Tan, Nedialkov & Pryce, Computers and Mathematics with Applications 74, 2017), until none is left. The
coefficients are exact expressions of parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.linalg import solve_triangular
from scipy.sparse.csgraph import connected_components

from daest.errors import ModelError
from daest.model.flat import FlatModel
from daest.numerics.matching import Tearing, block_triangular, maximum_matching, tear
from daest.numerics.ranks import equilibrated
from daest.systems.reduction.expand import ExpandedSystem, SamplePoint, expand, find_aliases, sparse_jacobian
from daest.systems.reduction.state_choice import (
    DependentEquations,
    LeadingJacobian,
    dependent_rows,
    leading_jacobian,
)
from daest.systems.reduction.symbolic_elimination import eliminate

CRAMER_LIMIT = 3  # unknowns; adjugate over determinant is valid at every regular point and short up to here
# Linear loops that are still written out; larger ones are solved by numbers wherever they are evaluated.
ELIMINATION_LIMIT = 200  # unknowns; coefficients of parameters only: sparse elimination
# Operations of the symbolic QR factors, which coefficients that vary need: derivatives by n states are n
# times as long, and a C compiler takes a second for ten thousand of them.
FACTOR_LIMIT = 3_000
GROWTH_LIMIT = 1e3  # errors amplified more than this cost more than three of sixteen digits
PIVOT_RATIO = (
    1e-4  # inside a loop an equation is solved for an unknown whose coefficient is at least this share
)


@dataclass(frozen=True)
class ImplicitLoop:
    """A loop that is closed by numbers: 0 = residual(tears, …), one row per tear; by a linear solver if it
    `is_linear` in the tears, else by a Newton iteration that `guess` starts.

    `row_size` is the size of the terms of every row at the sample point."""

    tears: ca.SX
    residual: ca.SX
    guess: np.ndarray
    row_size: np.ndarray
    is_linear: bool = False


@dataclass
class Definitions:
    """`symbols[i] = expressions[i]` in an order in which each uses earlier ones, known symbols and tears
    only.

    `loops` are those whose tears have no expression; `largest_loop` counts the tears of the largest loop of
    all."""

    symbols: list[ca.SX] = field(default_factory=list)
    expressions: list[ca.SX] = field(default_factory=list)
    loops: list[ImplicitLoop] = field(default_factory=list)
    largest_loop: int = 0

    def add(self, symbol: ca.SX, expression: ca.SX) -> None:
        self.symbols.append(symbol)
        self.expressions.append(expression)

    def insert_into(self, expression: ca.SX) -> ca.SX:
        """The expression with everything defined written out in known symbols and tears."""
        if not self.symbols:
            return expression
        symbols, values = [ca.vertcat(*self.symbols)], [ca.vertcat(*self.expressions)]
        return ca.substitute_inplace(symbols, values, [expression])[1][0]


@dataclass(frozen=True)
class Equations:
    """Square system 0 = residual(z; known, theta), its Jacobian in z and facts about the Jacobian's entries.

    `sample` are values of (z, known, theta), `values` the entries there, `begin` values of z from which loops
    are solved; `entry` numbers the entries from 1; `reach` (n_entries, n_z) tells which unknowns an entry
    depends on, `varying` whether it depends on more than theta."""

    residual: ca.SX
    z: ca.SX
    known: ca.SX
    theta: ca.SX
    sample: tuple[np.ndarray, np.ndarray, np.ndarray]
    begin: np.ndarray
    entries: list[Any]
    values: sp.csr_array
    entry: sp.csr_array
    reach: sp.csr_array
    varying: np.ndarray

    def evaluate(self, expression: ca.SX) -> np.ndarray:
        """Dense value at the sample point."""
        function = ca.Function("sample", [self.z, self.known, self.theta], [expression])
        return function(*self.sample).full()


@dataclass(frozen=True)
class Around:
    """Parameters whose effect on the solution is wanted to the first order, and their values (n,)."""

    symbols: ca.SX
    values: np.ndarray


def equations_at(
    residual: ca.SX,
    z: ca.SX,
    known: ca.SX,
    theta: ca.SX,
    sample: tuple[np.ndarray, np.ndarray, np.ndarray],
    begin: np.ndarray | None = None,
) -> Equations:
    """The system with its Jacobian differentiated and evaluated at the sample point; its loops are solved
    from `begin` (n,), else from there. Shapes: the point is z (n,), known (n_known,), theta (n_theta,)."""
    jacobian = sparse_jacobian(residual, z)
    rows, columns = (np.array(part, dtype=int) for part in jacobian.sparsity().get_triplet())
    entries: list[Any] = jacobian.nonzeros()
    stacked = ca.vertcat(ca.SX(0, 1), *entries)
    numbers = ca.Function("entries", [z, known, theta], [stacked])(*sample).full().ravel()
    shape = (residual.numel(), z.numel())
    reach = _dependence(stacked, z)
    varying = (np.diff(reach.indptr) > 0) | (np.diff(_dependence(stacked, known).indptr) > 0)
    values = _explicit_entries(numbers, rows, columns, shape)
    entry = _explicit_entries(np.arange(1, numbers.size + 1), rows, columns, shape)
    start = sample[0] if begin is None else begin
    return Equations(residual, z, known, theta, sample, start, entries, values, entry, reach, varying)


def _dependence(expression: ca.SX, symbols: ca.SX) -> sp.csr_array:
    rows, columns = ca.jacobian_sparsity(expression, symbols).get_triplet()
    return _explicit_entries(
        np.ones(len(rows)), np.array(rows, int), np.array(columns, int), (expression.numel(), symbols.numel())
    )


def _explicit_entries(
    values: np.ndarray, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]
) -> sp.csr_array:
    return sp.csr_array((values, (rows, columns)), shape=shape)


def solve_blocks(equations: Equations, check: sp.csr_array, around: Around | None = None) -> Definitions:
    """Definitions of all z. `check` is the Jacobian at the point where regularity is judged; nonlinear loops
    that are linear at the values of `around` are written out, to the first order in its parameters.

    Raises `DependentEquations` with the rows of a block that is singular there. Shapes: check (n, n)."""
    column_of = maximum_matching(equations.entry)
    if np.any(column_of < 0):
        raise DependentEquations(tuple(np.flatnonzero(column_of < 0).tolist()))
    blocks = block_triangular(equations.entry, column_of)
    _check_regular(blocks, check, column_of)
    pivots = np.asarray(equations.entry[np.arange(column_of.size), column_of]).ravel() - 1
    pivot_is_free = np.asarray(equations.reach[pivots, column_of]).ravel() == 0
    definitions = Definitions()
    for rows, columns in blocks:
        if rows.size == 1 and pivot_is_free[rows[0]]:
            pivot = equations.entries[pivots[rows[0]]]
            _solve_single(equations, int(rows[0]), int(columns[0]), pivot, definitions)
        else:
            _solve_loop(equations, rows, columns, definitions, around)
    return definitions


def _check_regular(
    blocks: list[tuple[np.ndarray, np.ndarray]], check: sp.csr_array, column_of: np.ndarray
) -> None:
    diagonal = np.asarray(check[np.arange(column_of.size), column_of]).ravel()
    for rows, columns in blocks:
        if rows.size == 1:
            dependent = np.flatnonzero(diagonal[rows] == 0)
        else:
            block = check[rows][:, columns].toarray()
            # A point outside of the domain of the equations, as x^n of a negative x, tells nothing.
            dependent = dependent_rows(block) if np.all(np.isfinite(block)) else np.zeros(0, dtype=int)
        if dependent.size:
            raise DependentEquations(tuple(rows[dependent].tolist()))


def _solve_single(
    equations: Equations, row: int, column: int, pivot: ca.SX, definitions: Definitions
) -> None:
    symbol = equations.z[column]
    definitions.add(symbol, -ca.substitute(equations.residual[row], symbol, 0) / pivot)


def _solve_loop(
    equations: Equations,
    rows: np.ndarray,
    columns: np.ndarray,
    definitions: Definitions,
    around: Around | None,
) -> None:
    """Tear, write the causal part as definitions, close the rest by elimination or by Newton's method."""
    inner = equations.entry[rows][:, columns]
    reach = equations.reach[inner.data - 1][:, columns]
    is_linear = reach.nnz == 0
    incidence = [set(inner.indices[inner.indptr[i] : inner.indptr[i + 1]].tolist()) for i in range(rows.size)]
    tearing = tear(incidence, _solvable(equations, rows, columns), columns.size, _bent(inner, reach))
    definitions.largest_loop = max(definitions.largest_loop, len(tearing.tears))
    if _growth(equations.values[rows][:, columns].toarray(), tearing) > GROWTH_LIMIT:
        # Solving along the tearing order would amplify rounding errors: the loop is closed as a whole.
        tearing = Tearing(tuple(range(columns.size)), (), tuple(range(rows.size)))
    causal = Definitions()
    for i, j in tearing.causal:
        pivot = equations.entries[int(inner[i, j]) - 1]
        _solve_single(equations, int(rows[i]), int(columns[j]), pivot, causal)
    if tearing.tears:
        tears = equations.z[columns[list(tearing.tears)].tolist()]
        core = causal.insert_into(equations.residual[rows[list(tearing.residual_rows)].tolist()])
        _close(equations, tears, core, is_linear, definitions, around)
    definitions.symbols += causal.symbols
    definitions.expressions += causal.expressions


def _bent(inner: sp.csr_array, reach: sp.csr_array) -> frozenset[int]:
    """Columns of a loop in which one of its rows is nonlinear: the coefficient varies with the unknown
    itself."""
    entries = sp.coo_array(reach)
    of_entry, unknown = entries.coords
    return frozenset(unknown[inner.indices[of_entry] == unknown].tolist())


def _growth(values: np.ndarray, tearing: Tearing) -> float:
    """Largest factor by which an error of a tear, or of an equation, reaches an unknown in the causal order,
    units scaled out. In long chains it can grow exponentially with the length."""
    if not tearing.causal:
        return 1.0
    rows, columns = (list(part) for part in zip(*tearing.causal, strict=True))
    scaled = equilibrated(values)
    right = np.hstack([scaled[np.ix_(rows, list(tearing.tears))], np.eye(len(rows))])
    response = solve_triangular(scaled[np.ix_(rows, columns)], right, lower=True)
    return float(np.abs(response).max(initial=0.0))


def _solvable(equations: Equations, rows: np.ndarray, columns: np.ndarray) -> list[set[int]]:
    """Unknowns that a row may safely be solved for: coefficient a constant or of parameters only, and not
    small."""
    inner, values = equations.entry[rows][:, columns], equations.values[rows][:, columns]
    found = []
    for i in range(rows.size):
        span = slice(inner.indptr[i], inner.indptr[i + 1])
        size = np.abs(values.data[span])
        steady = ~equations.varying[inner.data[span] - 1]
        good = steady & (size > 0) & (size >= PIVOT_RATIO * size.max(initial=0.0))
        found.append(set(inner.indices[span][good].tolist()))
    return found


def _close(
    equations: Equations,
    tears: ca.SX,
    core: ca.SX,
    is_linear: bool,
    definitions: Definitions,
    around: Around | None,
) -> None:
    solution = _written_out(equations, tears, core) if is_linear else None
    if not is_linear and around is not None and around.values.size:
        solution = _to_first_order(equations, tears, core, around)
    if solution is None:
        definitions.loops.append(_implicit(equations, tears, core, is_linear))
        return
    for symbol, expression in zip(ca.vertsplit(tears), ca.vertsplit(solution), strict=True):
        definitions.add(symbol, expression)


def _written_out(equations: Equations, tears: ca.SX, core: ca.SX) -> ca.SX | None:
    """The tears of a core that is linear in them; None where that takes too many operations."""
    matrix = ca.jacobian(core, tears)
    if _is_too_large(equations, matrix):
        return None
    return _solve_linear(equations, matrix, -ca.substitute(core, tears, ca.SX.zeros(tears.numel())))


def _to_first_order(equations: Equations, tears: ca.SX, core: ca.SX, around: Around) -> ca.SX | None:
    """The tears z = z0 + ∂z/∂s (s - s0), ∂z/∂s by the theorem of the implicit function, of a core that is
    linear in them at the values s0 of the parameters s of `around`; None where it is not."""
    at = ca.SX(around.values)
    there = ca.substitute(core, around.symbols, at)
    matrix = ca.jacobian(there, tears)
    if ca.depends_on(matrix, tears):
        return None
    solution = _written_out(equations, tears, there)
    if solution is None:
        return None
    slopes = ca.substitute(ca.jacobian(core, around.symbols), around.symbols, at)
    moved = ca.substitute(ca.mtimes(slopes, around.symbols - at), tears, solution)
    return solution + _solve_linear(equations, matrix, -moved)


def _is_too_large(equations: Equations, matrix: ca.SX) -> bool:
    n = matrix.shape[0]
    if n <= CRAMER_LIMIT or not ca.depends_on(matrix, ca.vertcat(equations.z, equations.known)):
        return n > ELIMINATION_LIMIT
    return n**2 > FACTOR_LIMIT or _factor_operations(matrix.sparsity()) > FACTOR_LIMIT


def _factor_operations(pattern: ca.Sparsity) -> int:
    """Operations of the symbolic solution of a system with this pattern."""
    matrix, right = ca.SX.sym("matrix", pattern), ca.SX.sym("right", pattern.size1())
    return int(ca.Function("solution", [matrix, right], [ca.solve(matrix, right)]).n_instructions())


def _implicit(equations: Equations, tears: ca.SX, core: ca.SX, is_linear: bool) -> ImplicitLoop:
    guess = np.asarray(ca.Function("begin", [equations.z], [tears])(equations.begin)).ravel()
    size = np.abs(equations.evaluate(ca.jacobian(core, tears))) @ np.maximum(np.abs(guess), 1.0)
    row_size = np.where(np.isfinite(size) & (size > 0), size, 1.0)
    return ImplicitLoop(tears, core, guess, row_size, is_linear)


def _solve_linear(equations: Equations, matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Symbolic solution: Cramer's rule if small, elimination with the pivots of the sample point if the
    matrix holds parameters only, else a symbolic QR factorisation, which needs no pivots."""
    if matrix.shape[0] <= CRAMER_LIMIT:
        dense = ca.densify(matrix)
        return ca.mtimes(ca.adj(dense), right) / ca.det(dense)
    if ca.depends_on(matrix, ca.vertcat(equations.z, equations.known)):
        return ca.solve(matrix, right)
    return eliminate(matrix, right, equations.evaluate(matrix))


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
    start[0] = [v.start_or_zero for v in system.aliases.variables]
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
