"""Index reduction: FlatModel -> ExplicitModel ẋ = f(x, u, v, w, θ, t) with all internal variables."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.errors import ModelError
from daest.model.explicit import ExplicitModel, InputDerivative
from daest.model.flat import FlatModel
from daest.systems.aliases import SELECT_RANK, find_aliases
from daest.systems.dummy_derivatives import PIVOT_CONSTANT, PIVOT_VARYING, DependentEquations, dummy_counts
from daest.systems.expand import ExpandedSystem, derivative_name, expand
from daest.systems.loops import Definitions, ImplicitLoop, equations_at, solve_blocks
from daest.systems.pantelides import (
    Differentiations,
    check_structure,
    differentiations,
    flat_signature,
    name_equations,
)
from daest.systems.sample_point import SamplePoint, nudged, sample_point

MOST_PLACES = 256  # sizes of alias groups beyond this are not told apart
NEWTON_STEPS = 50
NEWTON_TOLERANCE = 1e-11  # of a loop's residual and step, both scaled to the sample point


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


def reduce_index(flat: FlatModel) -> ExplicitModel:
    """The explicit form of the model, states chosen among its own variables.

    Steps: alias elimination; Pantelides' differentiation counts; dummy derivatives with pivots chosen by
    value at the start point, such that `stateSelect`, then differentiated variables with (fixed) start values
    stay states; block lower triangular order; tearing. Linear loops are written out, nonlinear ones become
    Newton iterations.

    Raises ModelError: `structurally-singular`, `singular-after-reduction`, `noise-differentiated`."""
    sigma = flat_signature(flat)
    check_structure(sigma, flat.equations, flat.unknowns, flat.name)
    in_source = differentiations(sigma)
    system = expand(flat, find_aliases(flat))
    point = sample_point(system)
    choice = _choose_states(system, point)
    definitions = _solve(system, choice, point)
    parts = _expressions(system, choice, definitions)
    _refuse_differentiated_noise(system, parts, definitions)
    return _assemble(system, choice, definitions, parts, in_source)


def _choose_states(system: ExpandedSystem, point: SamplePoint) -> StateChoice:
    """Dummy derivatives at the sample point; for a varying Jacobian that is singular there, at a generic one
    nearby."""
    counts, leading = system.counts, _leading_jacobian(system)
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
        raise _singular(system, [(i, 0) for i in error.rows]) from error


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


def _leading_jacobian(system: ExpandedSystem) -> LeadingJacobian:
    n, counts = system.sigma.n, system.counts
    rows, columns = np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    entries: list[Any] = []
    for order, symbols in enumerate(system.z[:2]):
        jacobian = ca.jacobian(system.residual[:n], symbols)
        i, j = (np.array(part, dtype=int) for part in jacobian.sparsity().get_triplet())
        leads = np.flatnonzero(counts.unknowns[j] - counts.equations[i] == order)
        nonzeros = jacobian.nonzeros()
        rows, columns = np.concatenate([rows, i[leads]]), np.concatenate([columns, j[leads]])
        entries += [nonzeros[e] for e in leads]
    unknowns, stacked = ca.vertcat(*system.z), ca.vertcat(ca.SX(0, 1), *entries)
    is_varying = ca.depends_on(stacked, ca.vertcat(unknowns, *system.u, *system.w, system.flat.time))
    function = ca.Function("leading", [unknowns, system.others], [stacked])
    return LeadingJacobian(function, rows, columns, n, is_varying)


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


def _solve(system: ExpandedSystem, choice: StateChoice, point: SamplePoint) -> Definitions:
    solved, states = choice.solved, choice.states
    z = _pick(system, solved)
    known = ca.vertcat(_pick(system, states), *system.u, *system.w, system.flat.time)
    n_theta = len(system.flat.parameters)

    def values(at: SamplePoint) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        plain, theta, time = np.split(at.others, [at.others.size - n_theta - 1, at.others.size - 1])
        return (
            np.array([at.z[k, j] for j, k in solved]),
            np.concatenate([[at.z[k, j] for j, k in states], plain, time]),
            theta,
        )

    equations = equations_at(system.residual, z, known, system.flat.theta, values(point))
    try:
        return solve_blocks(equations, equations.values)
    except DependentEquations as error:
        if not np.any(equations.varying):
            raise _singular(system, [system.rows[r] for r in error.rows]) from error
        elsewhere = equations_at(system.residual, z, known, system.flat.theta, values(nudged(point)))
        try:
            return solve_blocks(equations, elsewhere.values)
        except DependentEquations as generic:
            raise _singular(system, [system.rows[r] for r in generic.rows]) from generic


def _pick(system: ExpandedSystem, positions: list[tuple[int, int]]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *(system.z[k][j] for j, k in positions))


def _singular(system: ExpandedSystem, rows: list[tuple[int, int]]) -> ModelError:
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


@dataclass(frozen=True)
class Expressions:
    """ξ, ẋ and y in known symbols and loop tears; `rates` are those ξ' that the system contains, rows
    `rate_rows`."""

    variables: ca.SX
    rhs: ca.SX
    outputs: ca.SX
    rates: ca.SX
    rate_rows: np.ndarray


def _expressions(system: ExpandedSystem, choice: StateChoice, definitions: Definitions) -> Expressions:
    aliases, flat = system.aliases, system.flat
    sign, slot = ca.DM(aliases.sign), aliases.slot
    with_rate = np.flatnonzero(choice.highest[slot] >= 1)
    parts = [
        sign * system.z[0][slot.tolist(), 0],
        _pick(system, [(j, k + 1) for j, k in choice.states]),
        system.in_unknowns(flat.output_expressions),
        sign[with_rate.tolist(), 0] * system.z[1][slot[with_rate].tolist(), 0],
    ]
    stacked = definitions.insert_into(ca.vertcat(*parts))
    ends = np.cumsum([0, *(part.numel() for part in parts)]).tolist()
    variables, rhs, outputs, rates = (stacked[a:b] for a, b in pairwise(ends))
    return Expressions(variables, rhs, outputs, rates, with_rate)


def _refuse_differentiated_noise(
    system: ExpandedSystem, parts: Expressions, definitions: Definitions
) -> None:
    """Theorem 3.1 in structural form: no variable may contain a derivative of white noise."""
    if len(system.w) < 2 or not system.flat.noises:
        return
    used = _everything(parts, definitions)
    columns = ca.jacobian_sparsity(used, ca.vertcat(*system.w[1:])).get_triplet()[1]
    if not columns:
        return
    noise = int(columns[0]) % len(system.flat.noises)
    carriers = ca.jacobian_sparsity(system.flat.residual, system.flat.w[noise]).get_triplet()[0]
    kept = {int(row): i for i, row in enumerate(system.aliases.kept_equations)}
    guilty = tuple(row for row in carriers if system.counts.equations[kept[row]] > 0)
    name = system.flat.noises[noise].name
    raise ModelError(
        "noise-differentiated",
        "\n".join(
            [
                f"the white noise {name} would be differentiated: the model's constraints need the time "
                "derivative of",
                *name_equations(system.flat.equations, guilty),
            ]
        ),
        where=system.flat.noises[noise].place or next((system.flat.equations[r].place for r in guilty), None),
        remedy="let the noise enter where a force, torque, voltage or flow balances, not where positions, "
        "angles or other constrained variables are equated, or replace it by coloured noise; `daest noise` "
        "shows where it may enter",
    )


def _assemble(
    system: ExpandedSystem,
    choice: StateChoice,
    definitions: Definitions,
    parts: Expressions,
    in_source: Differentiations,
) -> ExplicitModel:
    flat, states = system.flat, choice.states
    derivatives = _needed_derivatives(system, parts, definitions)
    v = ca.vertcat(ca.SX(0, 1), *(system.u[d.order][d.index] for d in derivatives))
    symbols = [_pick(system, states), flat.u, v, flat.w, flat.theta, flat.time]
    tears = [loop.tears for loop in definitions.loops]
    rates = _only_known(parts.rates, [*symbols, *tears])
    rhs, variables, outputs, rate = _functions(
        symbols, [parts.rhs, parts.variables, parts.outputs, rates], definitions
    )
    chosen = [(system.aliases.variables[j], k) for j, k in states]
    return ExplicitModel(
        flat=flat,
        state_names=tuple(derivative_name(variable.name, k) for variable, k in chosen),
        state_units=tuple(_rate_unit(variable.unit, k) for variable, k in chosen),
        input_derivatives=derivatives,
        rhs=rhs,
        variables=variables,
        variable_derivatives=_derivative_function(derivatives, rhs, variables, rate, parts.rate_rows),
        outputs=outputs,
        is_symbolic=not definitions.loops,
        n_differentiations=int(in_source.equations.sum()),
        structural_index=in_source.structural_index,
        largest_loop=definitions.largest_loop,
    )


def _rate_unit(unit: str, order: int) -> str:
    return (unit or "1") + "/s" * order if order else unit


def _needed_derivatives(
    system: ExpandedSystem, parts: Expressions, definitions: Definitions
) -> tuple[InputDerivative, ...]:
    """The input derivatives on which any result depends, by order, then input."""
    n_inputs = len(system.flat.inputs)
    if len(system.u) < 2 or not n_inputs:
        return ()
    used = _everything(parts, definitions)
    columns = sorted(set(ca.jacobian_sparsity(used, ca.vertcat(*system.u[1:])).get_triplet()[1]))
    return tuple(InputDerivative(column % n_inputs, 1 + column // n_inputs) for column in columns)


def _everything(parts: Expressions, definitions: Definitions) -> ca.SX:
    """All that the functions of the explicit model compute."""
    loops = [definitions.insert_into(loop.residual) for loop in definitions.loops]
    return ca.vertcat(parts.variables, parts.rhs, parts.outputs, *loops)


def _only_known(expression: ca.SX, known: list[ca.SX]) -> ca.SX:
    """The expression with NaN in the rows that contain other symbols than the known ones."""
    strangers = [s for s in ca.symvar(expression) if not ca.depends_on(ca.vertcat(*known), s)]
    if not strangers:
        return expression
    rows = sorted(set(ca.jacobian_sparsity(expression, ca.vertcat(*strangers)).get_triplet()[0]))
    cleaned = ca.SX(expression)
    cleaned[rows] = np.nan
    return cleaned


ARGUMENTS = ["x", "u", "v", "w", "theta", "t"]
RESULTS = ["rhs", "variables", "outputs", "rates"]


def _functions(symbols: list[ca.SX], results: list[ca.SX], definitions: Definitions) -> list[ca.Function]:
    """Functions of (x, u, v, w, theta, t) for `RESULTS`; MX functions with Newton iterations where loops
    remain."""
    dense = [ca.densify(expression) for expression in results]
    if not definitions.loops:
        return [
            ca.Function(name, symbols, [expression], ARGUMENTS, ["value"])
            for name, expression in zip(RESULTS, dense, strict=True)
        ]
    arguments = [ca.MX.sym(n, s.numel()) for n, s in zip(ARGUMENTS, symbols, strict=True)]
    tears, known = ca.MX(0, 1), ca.SX(0, 1)
    for number, loop in enumerate(definitions.loops):
        solver, scale = _newton(f"loop{number}", loop, definitions, [*symbols, known])
        tears = ca.vertcat(tears, scale * solver(loop.guess / scale, ca.vertcat(*arguments, tears)))
        known = ca.vertcat(known, loop.tears)
    functions = []
    for name, expression in zip(RESULTS, dense, strict=True):
        inner = ca.Function(f"{name}_of_tears", [*symbols, known], [expression])
        functions.append(ca.Function(name, arguments, [inner(*arguments, tears)], ARGUMENTS, ["value"]))
    return functions


def _newton(
    name: str, loop: ImplicitLoop, definitions: Definitions, known: list[ca.SX]
) -> tuple[ca.Function, np.ndarray]:
    """Newton solver in tears / scale; rows of the residual are divided by the size of their terms at the
    guess."""
    scale = np.maximum(np.abs(loop.guess), 1.0)
    scaled = ca.SX.sym("scaled", loop.guess.size)
    residual = definitions.insert_into(loop.residual) / loop.row_size
    problem = {
        "x": scaled,
        "p": ca.vertcat(*known),
        "g": ca.substitute(residual, loop.tears, ca.DM(scale) * scaled),
    }
    options = {
        "abstol": NEWTON_TOLERANCE,
        "abstolStep": NEWTON_TOLERANCE,
        "max_iter": NEWTON_STEPS,
    }
    # This plugin can be written out as C code. Where it does not arrive it raises an error or gives NaN.
    return ca.rootfinder(name, "fast_newton", problem, options), scale


def _derivative_function(
    derivatives: tuple[InputDerivative, ...],
    rhs: ca.Function,
    variables: ca.Function,
    rates: ca.Function,
    rate_rows: np.ndarray,
) -> ca.Function:
    """ξ': from the system where it contains the derivative, else by the chain rule; NaN where that needs the
    derivative of a noise or one more derivative of an input than the model has."""
    kind: Any = ca.SX if rhs.is_a("SXFunction") else ca.MX
    arguments = [kind.sym(n, rhs.size1_in(i)) for i, n in enumerate(ARGUMENTS)]
    x, u, v, w, _, t = arguments
    position = {(d.index, d.order): i for i, d in enumerate(derivatives)}
    levels = [(i, 0) for i in range(u.numel())] + [(d.index, d.order) for d in derivatives]
    missing = kind.sym("missing", len(levels) + w.numel())
    rate = [
        v[position[i, k + 1]] if (i, k + 1) in position else missing[m] for m, (i, k) in enumerate(levels)
    ]
    rate += [missing[len(levels) + i] for i in range(w.numel())]
    along = ca.vertcat(rhs(*arguments), *rate, 1)
    chained = ca.jtimes(variables(*arguments), ca.vertcat(x, u, v, w, t), along)
    known = kind(ca.DM.nan(chained.numel(), 1))
    reachable = np.setdiff1d(
        np.arange(chained.numel()), ca.jacobian_sparsity(chained, missing).get_triplet()[0]
    )
    known[reachable.tolist()] = ca.substitute(chained, missing, kind.zeros(missing.numel()))[
        reachable.tolist()
    ]
    known[rate_rows.tolist()] = rates(*arguments)
    return ca.Function("variable_derivatives", arguments, [known], ARGUMENTS, ["value"])
