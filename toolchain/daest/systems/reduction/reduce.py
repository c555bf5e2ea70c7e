"""Index reduction: FlatModel -> ExplicitModel ẋ = f(x, u, v, w, θ, t) with all internal variables.

The functions of an explicit model, from the solved definitions of its variables.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import singledispatch
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.model.flat import Dynamics, ExplicitModel, FlatModel, InputDerivative, Model
from daest.systems.reduction.algebraic_start import agreed_start
from daest.systems.reduction.expand import (
    Differentiations,
    ExpandedSystem,
    SamplePoint,
    check_structure,
    derivative_name,
    differentiations,
    entries_of,
    flat_signature,
    name_equations,
    nudged,
    sample_point,
)
from daest.systems.reduction.loops import (
    CRAMER_LIMIT,
    Around,
    Definitions,
    ImplicitLoop,
    equations_at,
    regular_system,
    solve_blocks,
)
from daest.systems.reduction.state_choice import (
    DependentEquations,
    StateChoice,
    choose_states,
    singular_after_reduction,
)


@singledispatch
def dynamics(model: Model) -> Dynamics:
    """The form ẋ = f of a model, by which it is driven and filtered."""
    raise NotImplementedError(type(model).__name__)


def reduce_index(flat: FlatModel, first_order: Collection[str] = ()) -> ExplicitModel:
    """The explicit form of the model, states chosen among its own variables.

    `first_order` names parameters at whose values only values and first derivatives are wanted: a loop that
    is linear where they have these values is then written out, to the first order in them.

    Steps: alias elimination; Pantelides' differentiation counts; combinations of equations whose highest
    derivatives depend on each other (`systems.loops`); dummy derivatives with pivots chosen by
    value at the start point, such that `stateSelect`, then differentiated variables with (fixed) start values
    stay states; block lower triangular order; tearing. Linear loops are written out, nonlinear ones become
    Newton iterations.

    Raises ModelError: `structurally-singular`, `singular-after-reduction`, `noise-differentiated`.

        >>> explicit = daest.reduce_index(flat)
        >>> explicit.state_names
        ('motor.phi', 'motor.w', 'disc.phi', 'disc.w')
    """
    names = frozenset(first_order)
    for model, of_first_order, explicit in tuple(_reduced):
        if model is flat and of_first_order == names:
            return explicit
    explicit = _explicit(flat, first_order)
    _reduced.appendleft((flat, names, explicit))
    return explicit


_reduced: deque[tuple[FlatModel, frozenset[str], ExplicitModel]] = deque(maxlen=8)
"""What was reduced last: commands ask for the form of the same model from several places."""


def chosen_states(flat: FlatModel) -> tuple[str, ...]:
    """The names of the states that `reduce_index` chooses, in half of its time. Raises ModelError
    `structurally-singular`, `singular-after-reduction`; that the equations can be solved for what is no state
    is not asked."""
    return _chosen(flat).state_names


@dataclass(frozen=True)
class _Chosen:
    """Of a model, as far as its states are chosen: its differentiated equations, a point at which they hold,
    and the choice; `in_source` are the differentiation counts of the flat equations."""

    in_source: Differentiations
    system: ExpandedSystem
    point: SamplePoint
    choice: StateChoice

    @property
    def state_names(self) -> tuple[str, ...]:
        variables = self.system.aliases.variables
        return tuple(derivative_name(variables[j].name, k) for j, k in self.choice.states)


def _chosen(flat: FlatModel) -> _Chosen:
    for model, found in tuple(_begun):
        if model is flat:
            return found
    sigma = flat_signature(flat)
    check_structure(sigma, flat.equations, flat.unknowns, flat.name)
    in_source = differentiations(sigma)
    system = regular_system(flat)
    point = sample_point(system)
    found = _Chosen(in_source, system, point, choose_states(system, point))
    _begun.append((flat, found))
    return found


_begun: deque[tuple[FlatModel, _Chosen]] = deque(maxlen=1)
"""The model whose states were chosen last: who likes them asks for the rest."""


def _explicit(flat: FlatModel, first_order: Collection[str]) -> ExplicitModel:
    begun = _chosen(flat)
    system, choice = begun.system, begun.choice
    definitions = _solve(system, choice, begun.point, first_order)
    parts = expressions_of(system, choice, definitions)
    refuse_differentiated_noise(system, parts, definitions)
    return assemble(system, choice, definitions, parts, begun.in_source)


dynamics.register(FlatModel, reduce_index)


def _solve(
    system: ExpandedSystem, choice: StateChoice, point: SamplePoint, first_order: Collection[str]
) -> Definitions:
    solved, states = choice.solved, choice.states
    z = system.pick(solved)
    # What changes at events counts as known, not as a parameter: a coefficient that vanishes in some mode is
    # no pivot.
    memory = [i for i, p in enumerate(system.flat.parameters) if p.is_memory]
    steady = [i for i, p in enumerate(system.flat.parameters) if not p.is_memory]
    kept, tunable = (entries_of(system.flat.theta, part) for part in (memory, steady))
    known = ca.vertcat(system.pick(states), *system.u, *system.w, system.flat.time, kept)
    n_theta = len(system.flat.parameters)

    def values(at: SamplePoint) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        plain, theta, time = np.split(at.others, [at.others.size - n_theta - 1, at.others.size - 1])
        return (
            np.array([at.z[k, j] for j, k in solved]),
            np.concatenate([[at.z[k, j] for j, k in states], plain, time, theta[memory]]),
            theta[steady],
        )

    begin = _begun_at(system, solved, point)
    equations = equations_at(system.residual, z, known, tunable, values(point), begin)
    small = [i for i, p in enumerate(system.flat.parameters) if p.name in first_order]
    around = Around(entries_of(system.flat.theta, small), system.flat.theta_values[small])
    try:
        return solve_blocks(equations, equations.values, around)
    except DependentEquations as error:
        if not np.any(equations.varying):
            raise singular_after_reduction(system, [system.rows[r] for r in error.rows]) from error
        elsewhere = equations_at(system.residual, z, known, tunable, values(nudged(point)), begin)
        try:
            return solve_blocks(equations, elsewhere.values, around)
        except DependentEquations as generic:
            raise singular_after_reduction(system, [system.rows[r] for r in generic.rows]) from generic


def _begun_at(system: ExpandedSystem, solved: Sequence[tuple[int, int]], point: SamplePoint) -> np.ndarray:
    """Values (n,) of the solved symbols from which loops are solved: those of the sample point, but of an
    unknown that occurs nowhere differentiated the start value that the model gives, else what follows from
    the beginning of a recording.

    Of the several solutions that a loop may have, these tell which is meant. The sample point, where inputs
    without a start are 0, may lie on another: a membrane without pressure lets water back."""
    levels = {j for j, k in solved if k > 0}
    starts = [None if j in levels else v.start for j, v in enumerate(system.aliases.variables)]
    recorded = _recorded_point(system, point)
    return np.array(
        [starts[j] if starts[j] is not None else recorded[j] if k == 0 else point.z[k, j] for j, k in solved],
        dtype=float,
    )


def _recorded_point(system: ExpandedSystem, point: SamplePoint) -> np.ndarray:
    """Values (n,) of the kept unknowns at the beginning of a recording, as far as they follow one by one from
    what it tells of inputs and unknowns; the others, and all without a recording, as at the sample point."""
    flat, aliases = system.flat, system.aliases
    guesses = np.array([np.nan if v.guess is None else v.guess for v in flat.unknowns])
    is_told = np.isfinite(guesses)
    if not np.any(is_told):
        return point.z[0]
    xi = np.where(is_told, guesses, aliases.sign * point.z[0, aliases.slot])
    u = np.array([v.start_or_zero if v.guess is None else v.guess for v in flat.inputs])
    values = agreed_start(flat, xi, u, 0.0, is_told)[aliases.kept_unknowns]
    return np.where(np.isfinite(values), values, point.z[0])


NEWTON_STEPS = 50
NEWTON_TOLERANCE = 1e-11  # of a loop's residual and step, both scaled to the sample point
NEWTON_MISSED, NEWTON_LOST = 1e-8, 1e-6  # residual above which a loop is tried anew, and is called unsolved
DAMPED_DOUBLINGS, DAMPED_HALVINGS = 5, 10
BEYOND_FIRST, BEYOND_DOUBLINGS = 2.0**-8, 5  # of the size of the tears; 2 ** 5 starts, each twice as far off
BEYOND_SAME = 1e-6  # relative difference of one solution found twice
# A function whose result is a start only: it is not differentiated, and its code is not written twice.
UNTOUCHED: Any = {"never_inline": True, "is_diff_in": [False, False], "is_diff_out": [False]}
UNINLINED: Any = {"never_inline": True}
ARGUMENTS = ["x", "u", "v", "w", "theta", "t"]
RESULTS = ["rhs", "variables", "outputs", "rates"]


@dataclass(frozen=True)
class Expressions:
    """ξ, ẋ and y in known symbols and loop tears; `rates` are those ξ' that the system contains, rows
    `rate_rows`."""

    variables: ca.SX
    rhs: ca.SX
    outputs: ca.SX
    rates: ca.SX
    rate_rows: np.ndarray


def expressions_of(system: ExpandedSystem, choice: StateChoice, definitions: Definitions) -> Expressions:
    """What the explicit model computes, with all definitions written out."""
    aliases, flat = system.aliases, system.flat
    sign, slot = ca.DM(aliases.sign), aliases.slot
    with_rate = np.flatnonzero(choice.highest[slot] >= 1)
    parts = [
        sign * system.z[0][slot.tolist(), 0],
        system.pick([(j, k + 1) for j, k in choice.states]),
        system.in_unknowns(flat.output_expressions),
        sign[with_rate.tolist(), 0] * system.z[1][slot[with_rate].tolist(), 0],
    ]
    stacked = definitions.insert_into(ca.vertcat(*parts))
    ends = np.cumsum([0, *(part.numel() for part in parts)]).tolist()
    # An empty slice of a column is a row.
    variables, rhs, outputs, rates = (ca.reshape(stacked[a:b], b - a, 1) for a, b in pairwise(ends))
    return Expressions(variables, rhs, outputs, rates, with_rate)


def refuse_differentiated_noise(system: ExpandedSystem, parts: Expressions, definitions: Definitions) -> None:
    """Theorem 3.1 in structural form: no variable may contain a derivative of white noise.

    Raises ModelError `noise-differentiated` with the noise and the equations that would be differentiated."""
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


def assemble(
    system: ExpandedSystem,
    choice: StateChoice,
    definitions: Definitions,
    parts: Expressions,
    in_source: Differentiations,
) -> ExplicitModel:
    """The explicit model; `in_source` are the differentiation counts of the flat equations."""
    flat, states = system.flat, choice.states
    derivatives = _needed_derivatives(system, parts, definitions)
    v = ca.vertcat(ca.SX(0, 1), *(system.u[d.order][d.index] for d in derivatives))
    symbols = [system.pick(states), flat.u, v, flat.w, flat.theta, flat.time]
    tears = [loop.tears for loop in definitions.loops]
    rates = _only_known(parts.rates, [*symbols, *tears])
    results = [parts.rhs, parts.variables, parts.outputs, rates]
    near = _near_functions(symbols, results, definitions) if definitions.loops else []
    rhs, variables, outputs, rate = (
        [_from_scratch(name, function) for name, function in zip(RESULTS, near, strict=True)]
        if near
        else _functions(symbols, results)
    )
    chosen = [(system.aliases.variables[j], k) for j, k in states]
    has_newton = any(not loop.is_linear for loop in definitions.loops)
    chained = (derivatives, parts.rate_rows)
    return ExplicitModel(
        flat=flat,
        state_names=tuple(derivative_name(variable.name, k) for variable, k in chosen),
        state_units=tuple(_rate_unit(variable.unit, k) for variable, k in chosen),
        input_derivatives=derivatives,
        rhs=rhs,
        variables=variables,
        variable_derivatives=_derivative_function(*chained, rhs, variables, rate),
        outputs=outputs,
        is_symbolic=not definitions.loops,
        n_differentiations=int(in_source.equations.sum()),
        structural_index=in_source.structural_index,
        largest_loop=definitions.largest_loop,
        near=(near[0], near[2]) if has_newton else None,
        near_variables=near[1] if has_newton else None,
        of_tears=_of_tears(symbols, results, definitions) if has_newton else None,
        near_derivatives=_derivative_function(*chained, near[0], near[1], near[3]) if has_newton else None,
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
    names = {symbol.element_hash() for symbol in ca.symvar(ca.vertcat(*known))}
    strangers = [symbol for symbol in ca.symvar(expression) if symbol.element_hash() not in names]
    if not strangers:
        return expression
    rows = sorted(set(ca.jacobian_sparsity(expression, ca.vertcat(*strangers)).get_triplet()[0]))
    cleaned = ca.SX(expression)
    cleaned[rows] = np.nan
    return cleaned


def _functions(symbols: list[ca.SX], results: list[ca.SX]) -> list[ca.Function]:
    """Functions of (x, u, v, w, theta, t) for `RESULTS`, of a model whose loops are all written out."""
    return [
        ca.Function(name, symbols, [ca.densify(expression)], ARGUMENTS, ["value"])
        for name, expression in zip(RESULTS, results, strict=True)
    ]


def _near_functions(
    symbols: list[ca.SX], results: list[ca.SX], definitions: Definitions
) -> list[ca.Function]:
    """MX functions of (x, u, v, w, theta, t, guess) -> (value, tears) for `RESULTS`, with the loops that
    remain solved from the guess."""
    arguments = [ca.MX.sym(n, s.numel()) for n, s in zip(ARGUMENTS, symbols, strict=True)]
    guess = ca.MX.sym("guess", sum(loop.guess.size for loop in definitions.loops))
    tears, known, first = ca.MX(0, 1), ca.SX(0, 1), 0
    for number, loop in enumerate(definitions.loops):
        found = (_linear if loop.is_linear else _newton)(
            f"loop{number}", loop, definitions, [*symbols, known]
        )
        last = first + loop.guess.size
        tears = ca.vertcat(tears, found(guess[first:last], *arguments, tears))
        known, first = ca.vertcat(known, loop.tears), last
    functions = []
    for name, expression in zip(RESULTS, results, strict=True):
        inner = ca.Function(f"{name}_of_tears", [*symbols, known], [ca.densify(expression)])
        value = inner(*arguments, tears)
        functions.append(
            ca.Function(
                f"{name}_near", [*arguments, guess], [value, tears], [*ARGUMENTS, "guess"], ["value", "tears"]
            )
        )
    return functions


def _of_tears(
    symbols: list[ca.SX], results: list[ca.SX], definitions: Definitions
) -> tuple[ca.Function, ca.Function, ca.Function] | None:
    """Rates, outputs and residuals of the loops as functions of (x, u, v, w, theta, t, tears); None where the
    tears are more than Cramer's rule is short for."""
    tears = ca.vertcat(*(loop.tears for loop in definitions.loops))
    if tears.numel() > CRAMER_LIMIT:
        return None
    residual = ca.vertcat(*(loop.residual / loop.row_size for loop in definitions.loops))
    parts = {"rates": results[0], "outputs": results[2], "residual": definitions.insert_into(residual)}
    rates, outputs, rest = (
        ca.Function(f"{name}_of_tears", [*symbols, tears], [ca.densify(part)]) for name, part in parts.items()
    )
    return rates, outputs, rest


def _from_scratch(name: str, near: ca.Function) -> ca.Function:
    """The value of a function of `_near_functions` from the guess of the sample point."""
    arguments = near.mx_in()[:-1]
    value = near(*arguments, ca.DM.nan(near.numel_in(len(arguments)), 1))[0]
    return ca.Function(name, arguments, [value], ARGUMENTS, ["value"])


def _linear(
    name: str, loop: ImplicitLoop, definitions: Definitions, known: list[ca.SX]
) -> Callable[..., ca.MX]:
    """The tears by a sparse QR factorisation, of rows that are divided by the size of their terms."""
    residual = definitions.insert_into(loop.residual) / loop.row_size
    right = -ca.substitute(residual, loop.tears, ca.SX.zeros(loop.tears.numel()))
    system = ca.Function(f"{name}_system", known, [ca.jacobian(residual, loop.tears), ca.densify(right)])

    def solved(_: ca.MX, *at: ca.MX) -> ca.MX:
        matrix, value = system(*at)
        return ca.solve(matrix, value, "qr")

    return solved


def _newton(
    name: str, loop: ImplicitLoop, definitions: Definitions, known: list[ca.SX]
) -> Callable[..., ca.MX]:
    """The tears by a Newton iteration in tears / scale; rows of the residual are divided by the size of their
    terms at the guess."""
    scale = np.maximum(np.abs(loop.guess), 1.0)
    scaled = ca.SX.sym("scaled", loop.guess.size)
    residual = definitions.insert_into(loop.residual) / loop.row_size
    everything = ca.vertcat(*known)
    # Only what the loop contains: CasADi takes the solution to depend on all that it is given.
    inside = sorted(set(ca.jacobian_sparsity(residual, everything).get_triplet()[1]))
    problem = {
        "x": scaled,
        "p": everything[inside],
        "g": ca.substitute(residual, loop.tears, ca.DM(scale) * scaled),
    }
    options = {
        "abstol": NEWTON_TOLERANCE,
        "abstolStep": NEWTON_TOLERANCE,
        "max_iter": NEWTON_STEPS,
    }
    solved = _guarded(name, problem, options, loop.guess / scale, scale)
    return lambda near, *at: solved(near, ca.vertcat(*at)[inside])


def _guarded(
    name: str, problem: dict[str, ca.SX], options: dict[str, Any], guess: np.ndarray, scale: np.ndarray
) -> ca.Function:
    """(tears nearby, p) -> tears: full Newton steps from the tears nearby, where these are numbers, else from
    the guess; where they do not arrive, from the guess, then damped ones, then from starts farther and
    farther off (`_beyond`). Where these do not either it raises an error, and gives NaN as C code.

    The plugin that can be written out as C code does not tell there whether it arrived, so that the residual
    is looked at. The damped iteration is evaluated only where it is needed."""
    inner = ca.Function(f"{name}_residual", [problem["x"], problem["p"]], [problem["g"]])
    z, p = ca.MX.sym("z", guess.size), ca.MX.sym("p", problem["p"].numel())

    def missed(at: ca.MX, tolerance: float) -> ca.MX:
        # A sum, which is no number where a residual is none: CasADi's largest would pass over that.
        return ca.logic_not(ca.norm_1(inner(at, p)) <= tolerance)

    attempt = ca.rootfinder(f"{name}_attempt", "fast_newton", problem, {**options, "error_on_fail": False})
    arrive = ca.rootfinder(name, "fast_newton", problem, options)
    begin = ca.MX.sym("begin", guess.size)

    def or_else(what: str, result: ca.MX) -> ca.Function:
        """(is missed, z, begin, p) -> the result where it is, else z."""
        other = ca.Function(f"{name}_{what}", [z, begin, p], [result])
        kept = ca.Function(f"{name}_kept", [z, begin, p], [z])
        return ca.Function.if_else(f"{name}_or_{what}", other, kept)

    walked = _damped_newton(name, inner, guess)(guess, p)
    elsewhere = _beyond(name, inner, attempt)(begin, p)
    # From where nothing was found, which is no number, the iteration would not tell that it did not arrive.
    end = arrive(ca.if_else(ca.fabs(elsewhere) < np.inf, elsewhere, walked), p)
    lost = ca.if_else(missed(end, NEWTON_LOST), np.nan, 0.0)
    or_beyond = or_else("beyond", end + lost)
    damped = attempt(walked, p)
    or_damped = or_else("damped", or_beyond(missed(damped, NEWTON_LOST), damped, begin, p))
    plain = attempt(guess, p)
    or_anew = or_else("anew", or_damped(missed(plain, NEWTON_MISSED), plain, begin, p))
    nearby = ca.MX.sym("nearby", guess.size)
    is_known = ca.fabs(nearby) < np.inf  # no number is not
    at = ca.if_else(is_known, nearby / scale, guess)
    first = attempt(at, p)
    # What leads to the solution is not differentiated: ways that were not taken may have no number.
    solution: Any = {
        "never_inline": True,
        "custom_jacobian": _slopes_of_solution(f"jac_{name}_found", problem),
        "jac_penalty": 0,
    }
    found = ca.Function(
        f"{name}_found", [nearby, p], [or_anew(missed(first, NEWTON_MISSED), first, at, p)], solution
    )
    return ca.Function(f"{name}_guarded", [nearby, p], [scale * found(nearby, p)])


def _slopes_of_solution(name: str, problem: dict[str, ca.SX]) -> ca.Function:
    """(anything nearby, p, z) -> ∂z/∂nearby = 0 and ∂z/∂p of the solution z of 0 = g(z, p): the theorem of
    the implicit function."""
    z, p, g = problem["x"], problem["p"], problem["g"]
    n = z.numel()
    by_p = ca.densify(-ca.solve(ca.densify(ca.jacobian(g, z)), ca.densify(ca.jacobian(g, p))))
    return ca.Function(
        name,
        [ca.SX.sym("nearby", n), p, z],
        [ca.SX(n, n), by_p],
        ["i0", "i1", "out_o0"],
        ["jac_o0_i0", "jac_o0_i1"],
    )


def _damped_newton(name: str, residual: ca.Function, guess: np.ndarray) -> ca.Function:
    """(z, p) -> z after 2 ** `DAMPED_DOUBLINGS` Newton steps, each shortened to the half, the quarter, …
    that leaves the smallest residual."""
    n = guess.size
    z, p = ca.MX.sym("z", n), ca.MX.sym("p", residual.numel_in(1))
    step = _newton_step(residual, z, p)
    best, size = z, ca.norm_2(residual(z, p))
    for halvings in range(DAMPED_HALVINGS):
        there = z - step / 2**halvings
        found = ca.norm_2(residual(there, p))
        is_better = found < size  # never where it is no number
        best, size = ca.if_else(is_better, there, best), ca.if_else(is_better, found, size)
    walk = ca.Function(f"{name}_step", [z, p], [best], UNTOUCHED)
    for level in range(DAMPED_DOUBLINGS):
        walk = ca.Function(f"{name}_walk{level}", [z, p], [walk(walk(z, p), p)], UNTOUCHED)
    return walk


def _beyond(name: str, residual: ca.Function, attempt: ca.Function) -> ca.Function:
    """(z, p) -> a solution away from z, where the one that z belonged to has ended; NaN where none is found.

    A solution that changes with p ends where two meet, in a fold, and the loop jumps to another: a trigger
    with hysteresis switches. Near a fold the Newton step points along the direction in which the two met;
    Newton iterations start on that line on either side, each twice as far off as the one before, until one
    arrives. Where the sides lead to different solutions the equations do not tell where it jumps: NaN."""
    n = residual.numel_in(0)
    z, p, found = ca.MX.sym("z", n), ca.MX.sym("p", residual.numel_in(1)), ca.MX.sym("found", n)
    along, off = ca.MX.sym("along", n), ca.MX.sym("off")

    def is_missed(at: ca.MX) -> ca.MX:
        return ca.logic_not(ca.norm_1(residual(at, p)) <= NEWTON_MISSED)

    arguments = [found, off, z, along, p]
    other = ca.Function(f"{name}_hop", arguments, [attempt(z + off * along, p)])
    kept = ca.Function(f"{name}_stay", arguments, [found])
    either = ca.Function.if_else(f"{name}_hop_or_stay", other, kept)
    search = ca.Function(
        f"{name}_search0", arguments, [either(is_missed(found), *arguments), 2 * off], UNINLINED
    )
    for level in range(BEYOND_DOUBLINGS):
        once = search(*arguments)
        twice = search(*once, z, along, p)
        search = ca.Function(f"{name}_search{level + 1}", arguments, list(twice), UNINLINED)
    step = _newton_step(residual, z, p)
    line = step / ca.norm_inf(step) if n > 1 else ca.MX(1)
    nothing, first = ca.MX(ca.DM.nan(n, 1)), BEYOND_FIRST * (1 + ca.norm_inf(z))
    up, down = (search(nothing, first, z, sign * line, p)[0] for sign in (1, -1))
    missed_up, missed_down = is_missed(up), is_missed(down)
    is_one = ca.norm_inf(up - down) <= BEYOND_SAME * (1 + ca.norm_inf(up))
    or_down = ca.if_else(ca.logic_or(missed_up, is_one), down, nothing)
    chosen = ca.if_else(missed_down, ca.if_else(missed_up, nothing, up), or_down)
    return ca.Function(f"{name}_elsewhere", [z, p], [chosen], UNTOUCHED)


def _newton_step(residual: ca.Function, z: ca.MX, p: ca.MX) -> ca.MX:
    value = residual(z, p)
    matrix = ca.densify(ca.jacobian(value, z)) if z.numel() == 1 else ca.jacobian(value, z)
    return value / matrix if z.numel() == 1 else ca.solve(matrix, value, "qr")


def _derivative_function(
    derivatives: tuple[InputDerivative, ...],
    rate_rows: np.ndarray,
    rhs: ca.Function,
    variables: ca.Function,
    rates: ca.Function,
) -> ca.Function:
    """ξ': from the system where it contains the derivative, else by the chain rule; NaN where that needs the
    derivative of a noise or one more derivative of an input than the model has. Of functions with a guess the
    result has it, too."""
    kind: Any = ca.SX if rhs.is_a("SXFunction") else ca.MX
    arguments = [kind.sym(rhs.name_in(i), rhs.size1_in(i)) for i in range(rhs.n_in())]
    x, u, v, w, _, t = arguments[:6]
    position = {(d.index, d.order): i for i, d in enumerate(derivatives)}
    levels = [(i, 0) for i in range(u.numel())] + [(d.index, d.order) for d in derivatives]
    missing = kind.sym("missing", len(levels) + w.numel())
    rate = [
        v[position[i, k + 1]] if (i, k + 1) in position else missing[m] for m, (i, k) in enumerate(levels)
    ]
    rate += [missing[len(levels) + i] for i in range(w.numel())]
    along = ca.vertcat(rhs.call(arguments)[0], *rate, 1)
    chained = ca.jtimes(variables.call(arguments)[0], ca.vertcat(x, u, v, w, t), along)
    known = kind(ca.DM.nan(chained.numel(), 1))
    reachable = np.setdiff1d(
        np.arange(chained.numel()), ca.jacobian_sparsity(chained, missing).get_triplet()[0]
    )
    if reachable.size:  # an empty selection has the shape of a row
        reached = reachable.tolist()
        known[reached] = ca.substitute(chained, missing, kind.zeros(missing.numel()))[reached]
    if rate_rows.size:
        known[rate_rows.tolist()] = rates.call(arguments)[0]
    return ca.Function("variable_derivatives", arguments, [known], rhs.name_in(), ["value"])
