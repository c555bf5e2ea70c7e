"""Linear DAE of a flat model, E ξ' = J ξ + K u + B w + offset, with θ symbolic: report (3), (8), (19)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import singledispatch

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.errors import ConfigError, DaestError, NumericalError
from daest.model.flat import Dynamics, ExplicitModel, FlatModel, Model
from daest.model.linear import LinearDAE, Matrix
from daest.systems.reduction.algebraic_start import agreed_start

DENSE_LIMIT = 500
"""From this many equations on, E and J are kept sparse."""

MATRIX_NAMES = ("E", "J", "K", "B", "C", "D", "H", "offset", "output_offset")


BESIDE = (1e-4, 1e-6)
"""Relative distances from an operating point, over which a slope that is infinite there grows."""

STEPS = frozenset(
    getattr(ca, f"OP_{name}") for name in ("SIGN", "COPYSIGN", "FLOOR", "CEIL", "LT", "LE", "EQ", "NE")
)
"""Functions that are constant in pieces, whose derivative CasADi takes for zero."""


@dataclass(frozen=True)
class ThetaEntry:
    """An entry of a matrix that depends on parameters; row and column count from 0."""

    matrix: str
    row: int
    column: int
    expression: str
    parameters: tuple[str, ...]


MOST_TURNS = 50  # of relations and discrete variables until they agree at an operating point


@dataclass(frozen=True)
class OperatingPoint:
    """Values that the model is linearised at: ξ' and ξ (n,), u (n_u,), time. White noise is zero there."""

    derivatives: np.ndarray
    xi: np.ndarray
    u: np.ndarray
    time: float
    is_given: bool  # False: start values, because the caller gave none


@singledispatch
def linearize(
    model: Model, theta: np.ndarray | None = None, at: Mapping[str, float] | None = None
) -> LinearDAE:
    """The linear DAE of `model` at the parameters `theta` (None: the values of the model).

    `at` maps unknowns, inputs, `der(name)` and `time` to the operating point; what it leaves out is at its
    start value, or zero (algebraic unknowns: at values that agree with these), and derivatives and the time
    are zero. An affine model is the same everywhere, so there `at` has no effect. For a nonlinear model
    without `at` the start values are used, and a note in the result says so; another note tells the time
    where the equations contain it. A model with events is in the mode in which it starts; with `at` in that
    of the operating point, which may name Boolean and Integer variables, too. Shapes: theta (n_theta,).
    """
    raise NotImplementedError(type(model).__name__)


@linearize.register
def _of_equations(
    flat: FlatModel, theta: np.ndarray | None = None, at: Mapping[str, float] | None = None
) -> LinearDAE:
    if flat.events is not None:
        return _in_its_mode(flat, theta, at)
    values = flat.checked_theta(theta)
    is_affine = is_affine_model(flat)
    point = operating_point(flat, at)
    family = _family(flat, _at_zero(flat) if is_affine else point)
    matrices = [sp.csc_array(m.sparse()) for m in family(values)]
    unread = _unread_rows(flat, matrices, point)
    if unread:
        found = linearize(_with_values(flat, unread, point), theta, at)
        names = ", ".join(flat.unknowns[column].name for column in unread.values())
        note = f"No slope at the operating point, and read by nothing else, so at its value: {names}."
        return replace(found, equations=flat.equations, notes=(*found.notes, note))
    try:
        _check_finite(flat, matrices)
    except NumericalError:
        begins = _where_it_begins(flat, values) if at is None else None
        if begins is None:
            raise
        found = linearize(flat, theta, begins)
        note = "Not finite at the declared start values: these are its matrices where its simulation begins."
        return replace(found, notes=(note, *found.notes))
    E, J, K, B, C, D, H, offset, output_offset = matrices
    return LinearDAE(
        equations=flat.equations,
        unknowns=flat.unknowns,
        inputs=flat.inputs,
        noises=flat.noises,
        outputs=flat.outputs,
        parameters=tuple(replace(p, value=float(v)) for p, v in zip(flat.parameters, values, strict=True)),
        E=_compact(E),
        J=_compact(J),
        K=K.toarray(),
        B=B.toarray(),
        C=C.toarray(),
        D=D.toarray(),
        H=H.toarray(),
        offset=offset.toarray().ravel(),
        output_offset=output_offset.toarray().ravel(),
        is_affine=is_affine,
        notes=(*_notes(flat, is_affine, point), *(() if is_affine else _lost_slopes(flat, values, point))),
        family=family,
    )


def _in_its_mode(flat: FlatModel, theta: np.ndarray | None, at: Mapping[str, float] | None) -> LinearDAE:
    """The linear DAE of a model with events in the mode in which it starts, or in that of the operating
    point."""
    from daest.systems.events.modes import frozen, in_starting_mode, mode_text, without_noise

    # A noise that would be differentiated forbids a reduction, and leaves the mode as it is.
    quiet = without_noise(flat)
    values, which = in_starting_mode(quiet, theta=theta).theta_values, "it starts in"
    if at is not None:
        values, which = _mode_at(quiet, values, at), "of the operating point"
    found = linearize(frozen(flat, values), at=continuous_part(flat, at))
    mode = mode_text(flat, values)
    note = f"The model changes at events: these are the matrices of the mode {which} ({mode})."
    return replace(found, notes=(note, *found.notes))


def continuous_part(flat: Model, at: Mapping[str, float] | None) -> Mapping[str, float] | None:
    """An operating point without the Boolean and Integer variables that events assign."""
    if at is None or flat.events is None or not isinstance(flat, FlatModel):
        return at
    discrete = {one.name for one in flat.events.assignments if one.slot >= 0}
    discrete |= {_remembered(one.name) for one in flat.events.memories}
    continuous = {v.name for v in (*flat.unknowns, *flat.inputs)}
    return {name: value for name, value in at.items() if name in continuous or name not in discrete}


def _remembered(name: str) -> str:
    """The variable x of `pre(x)`."""
    return name.removeprefix("pre(").removesuffix(")")


def _mode_at(flat: FlatModel, begun: np.ndarray, at: Mapping[str, float]) -> np.ndarray:
    """Parameters with the mode of an operating point (n_theta,).

    Discrete variables that events assign have the values that `at` gives them; the others and the relations
    follow, from the mode `begun` or values of `at` before the event on. Raises NumericalError
    `events-do-not-settle`."""
    from daest.systems.events.event_update import unsettled
    from daest.systems.events.modes import frozen

    events = flat.events
    assert events is not None
    discrete = [(i, one) for i, one in enumerate(events.assignments) if one.slot >= 0]
    given = {one.slot: float(at[one.name]) for _, one in discrete if one.name in at}
    symbols = [flat.derivatives, flat.xi, flat.u, flat.w, flat.theta, flat.time, events.active, events.ticks]
    told = [events.values, events.wholes, events.assigned, events.sources]
    function = ca.Function("mode", symbols, [ca.densify(part) for part in told])
    values = begun.copy()
    values[list(given)] = list(given.values())
    for memory in events.memories:
        values[memory.slot] = at.get(_remembered(memory.name), values[memory.slot])
    for _ in range(MOST_TURNS):
        point = operating_point(frozen(flat, values), continuous_part(flat, at))
        none = np.zeros(flat.w.numel()), np.zeros(events.active.numel()), np.zeros(events.ticks.numel())
        arguments = (point.derivatives, point.xi, point.u, none[0], values, point.time, *none[1:])
        relations, wholes, assigned, sources = (part.full().ravel() for part in function(*arguments))
        new = values.copy()
        for one, value in zip(events.relations, relations, strict=True):
            new[one.slot] = float(value > 0 if one.is_strict else value >= 0)
        new[[one.slot for one in events.whole_parts]] = np.floor(wholes)
        new[[one.slot for one in events.memories]] = sources
        new[[one.slot for _, one in discrete]] = assigned[[i for i, _ in discrete]]
        new[list(given)] = list(given.values())
        if np.array_equal(new, values, equal_nan=True):
            return values
        values = new
    raise unsettled(float(at.get("time", 0.0)), "the operating point")


def linear_dae_function(flat: FlatModel, at: Mapping[str, float] | None = None) -> ca.Function:
    """CasADi function θ -> E, J, K, B, C, D, H, offset, output_offset (sparse), with exact derivatives in θ.

    `at` as in `linearize`. Output names are `MATRIX_NAMES`.

        >>> daest.linear_dae_function(flat)(flat.theta_values)[0].shape
        (65, 65)
    """
    return _family(flat, _expansion_point(flat, at))


def _family(flat: FlatModel, point: OperatingPoint) -> ca.Function:
    return ca.Function("linear_dae", [flat.theta], _matrices(flat, point), ["theta"], list(MATRIX_NAMES))


@singledispatch
def is_affine_model(model: Model) -> bool:
    """True when F and h are affine in (ξ', ξ, u, w) with coefficients that do not depend on time. Exact."""
    raise NotImplementedError(type(model).__name__)


@is_affine_model.register
def _has_affine_equations(flat: FlatModel) -> bool:
    signals = ca.vertcat(flat.derivatives, flat.xi, flat.u, flat.w)
    return is_affine(ca.vertcat(flat.residual, flat.output_expressions), signals, flat.time)


def is_affine(expressions: ca.SX, signals: ca.SX, time: ca.SX) -> bool:
    """True when the expressions are affine in the signals with coefficients that do not depend on time.
    Exact."""
    if not ca.is_linear(expressions, signals) or ca.depends_on(expressions, time):
        return False
    return not _has_steps(expressions, signals)


def _has_steps(expressions: ca.SX, signals: ca.SX) -> bool:
    """Whether a function that is constant in pieces acts on the signals: to CasADi sign(x) is linear in x."""
    function = ca.Function("expressions", [signals, *_others(expressions, signals)], [expressions])
    moving = [False] * function.sz_w()
    for k in range(function.n_instructions()):
        operation, source = function.instruction_id(k), function.instruction_input(k)
        target = function.instruction_output(k)
        if operation == ca.OP_INPUT:
            moving[target[0]] = source[0] == 0
        elif operation == ca.OP_CONST:
            moving[target[0]] = False
        elif operation != ca.OP_OUTPUT:
            moving[target[0]] = any(moving[i] for i in source)
            if moving[target[0]] and operation in STEPS:
                return True
    return False


def _others(expressions: ca.SX, signals: ca.SX) -> list[ca.SX]:
    known = {symbol.element_hash() for symbol in ca.symvar(signals)}
    return [symbol for symbol in ca.symvar(expressions) if symbol.element_hash() not in known]


def operating_point(flat: FlatModel, at: Mapping[str, float] | None = None) -> OperatingPoint:
    """Operating point from `at`, start values and zeros. ConfigError for a name that does not exist.

    Algebraic unknowns of a nonlinear model that are not named take values that agree with the others.
    """
    is_given, at = at is not None, dict(at or {})
    held = np.array([v.name in at for v in flat.unknowns], dtype=bool)
    xi = [at.pop(v.name, v.start_or_zero) for v in flat.unknowns]
    u = [at.pop(v.name, v.start_or_zero) for v in flat.inputs]
    derivatives = [at.pop(f"der({v.name})", 0.0) for v in flat.unknowns]
    time = at.pop("time", 0.0)
    if at:
        raise ConfigError(
            "operating-point-unknown-name",
            f"The operating point names {', '.join(sorted(at))}, which the model {flat.name} does not have.",
            remedy="Use names of unknowns and inputs as `daest linearize` lists them, `der(name)` or `time`.",
        )
    values, inputs = np.array(xi, dtype=float), np.array(u, dtype=float)
    if not is_affine_model(flat):
        values = agreed_start(flat, values, inputs, time, held)
    return OperatingPoint(np.array(derivatives), values, inputs, time, is_given)


def theta_entries(flat: FlatModel, at: Mapping[str, float] | None = None) -> list[ThetaEntry]:
    """The entries of all matrices that depend on θ, with their expression in the names of the model."""
    names = flat.parameter_names
    symbols = ca.vertcat(ca.SX(0, 1), *[ca.SX.sym(name) for name in names])
    entries: list[ThetaEntry] = []
    for matrix, value in zip(MATRIX_NAMES, _matrices(flat, _expansion_point(flat, at)), strict=True):
        named = ca.substitute(value, flat.theta, symbols)
        for row, column in zip(*value.sparsity().get_triplet(), strict=True):
            expression = named[row, column]
            if ca.symvar(expression):
                entries.append(_theta_entry(matrix, row, column, expression))
    return entries


def _theta_entry(matrix: str, row: int, column: int, expression: ca.SX) -> ThetaEntry:
    parameters = tuple(sorted(symbol.name() for symbol in ca.symvar(expression)))
    text = str(expression)
    if text.startswith("(") and text.endswith(")") and _closes_at_end(text):
        text = text[1:-1]
    return ThetaEntry(matrix, row, column, text, parameters)


def _closes_at_end(text: str) -> bool:
    """True when the first parenthesis is closed by the last character."""
    depth = 0
    for position, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            return position == len(text) - 1
    return False


def _at_zero(flat: FlatModel) -> OperatingPoint:
    zero = np.zeros(flat.n)
    return OperatingPoint(zero, zero, np.zeros(len(flat.inputs)), 0.0, is_given=True)


def _expansion_point(flat: FlatModel, at: Mapping[str, float] | None) -> OperatingPoint:
    """Where the slopes are taken: of an affine model they are the same everywhere."""
    return _at_zero(flat) if is_affine_model(flat) else operating_point(flat, at)


def _matrices(flat: FlatModel, point: OperatingPoint) -> list[ca.SX]:
    """E, J, K, B, C, D, H, offset, output_offset as SX in θ, at the operating point."""
    F, h = flat.residual, flat.output_expressions
    E, J, K, B = (
        ca.jacobian(F, flat.derivatives),
        -ca.jacobian(F, flat.xi),
        -ca.jacobian(F, flat.u),
        -ca.jacobian(F, flat.w),
    )
    C, D, H = (ca.jacobian(h, symbols) for symbols in (flat.xi, flat.u, flat.w))
    # F(point) + E (ξ' - ξ0') - J (ξ - ξ0) - K (u - u0) - B w = 0, so the offset is what is left at ξ = u = 0.
    offset = E @ ca.SX(point.derivatives) - J @ ca.SX(point.xi) - K @ ca.SX(point.u) - F
    output_offset = h - C @ ca.SX(point.xi) - D @ ca.SX(point.u)
    signals = ca.vertcat(flat.derivatives, flat.xi, flat.u, flat.w, flat.time)
    values = ca.vertcat(point.derivatives, point.xi, point.u, np.zeros(len(flat.noises)), point.time)
    expressions = [E, J, K, B, C, D, H, offset, output_offset]
    return [ca.sparsify(m) for m in ca.substitute(expressions, [signals], [ca.SX(values)])]


def _compact(matrix: sp.csc_array) -> Matrix:
    """Dense for small models, else compressed rows without stored zeros."""
    if matrix.shape[0] < DENSE_LIMIT:
        return matrix.toarray()
    rows = sp.csr_array(matrix)
    rows.eliminate_zeros()
    return rows


def _unread_rows(flat: FlatModel, matrices: list[sp.csc_array], point: OperatingPoint) -> dict[int, int]:
    """Rows without finite slopes, each with the unknown that it computes for nobody: no other equation and no
    output reads it. Empty where another row is not finite, or an unknown is read."""
    E, J, K, B = matrices[:4]
    bad: set[int] = set()
    for matrix in (E, J, K, B, matrices[7]):
        entries = sp.coo_array(matrix)
        bad |= set(entries.coords[0][~np.isfinite(entries.data)].tolist())
    if not bad or not np.all(np.isfinite(point.xi)):
        return {}
    readers = sp.csc_array(ca.DM(ca.jacobian_sparsity(flat.residual, flat.xi), 1).sparse())
    seen = set(ca.jacobian_sparsity(flat.output_expressions, flat.xi).get_triplet()[1])
    seen |= set(ca.jacobian_sparsity(flat.residual, flat.derivatives).get_triplet()[1])
    own = np.flatnonzero(np.diff(readers.indptr) == 1)
    unread = {int(readers.indices[readers.indptr[j]]): int(j) for j in own if j not in seen}
    return {row: unread[row] for row in sorted(bad)} if bad <= set(unread) else {}


def _with_values(flat: FlatModel, rows: Mapping[int, int], point: OperatingPoint) -> FlatModel:
    """The model with `unknown = value` in place of some rows."""
    residual = ca.SX(flat.residual)
    for row, column in rows.items():
        residual[row] = flat.xi[column] - point.xi[column]
    return replace(flat, residual=residual)


def _where_it_begins(flat: FlatModel, values: np.ndarray) -> dict[str, float] | None:
    """The point at which a simulation of the model begins: start values may leave out what follows from
    constraints, as the length of a spring between two bodies. None where that has no solution."""
    from daest.systems.reduction.initialize import initial_point
    from daest.systems.reduction.reduce import reduce_index

    begun = flat.with_theta(dict(zip(flat.parameter_names, values.tolist(), strict=True)))
    try:
        explicit = reduce_index(begun)
        u = np.array([v.start_or_zero for v in flat.inputs])
        u = np.concatenate([u, np.zeros(explicit.rhs.numel_in(1) - u.size)])
        v, w = (np.zeros(explicit.rhs.numel_in(i)) for i in (2, 3))
        x0, xi = initial_point(explicit, values, u, v, 0.0)
        rates = np.array(explicit.variable_derivatives(x0, u, v, w, values, 0.0)).ravel()
    except (DaestError, RuntimeError):
        return None
    names = flat.unknown_names
    found = dict(zip(names, xi.tolist(), strict=True))
    moving = zip(names, rates.tolist(), strict=True)
    return found | {f"der({name})": rate for name, rate in moving if np.isfinite(rate)}


def _check_finite(flat: FlatModel, matrices: list[sp.csc_array]) -> None:
    """Raise NumericalError that names the first equation with an infinite or undefined coefficient."""
    for name, matrix in zip(MATRIX_NAMES, matrices, strict=True):
        entries = sp.coo_array(matrix)
        bad = entries.coords[0][~np.isfinite(entries.data)]
        if bad.size == 0:
            continue
        is_output = name in ("C", "D", "H", "output_offset")
        what = flat.outputs[bad[0]].name if is_output else flat.equations[bad[0]].text
        raise NumericalError(
            "linearization-not-finite",
            f"The coefficients of `{what}` are infinite or undefined at the operating point.",
            where=flat.outputs[bad[0]].place if is_output else flat.equations[bad[0]].place,
            remedy="Give another operating point with --at, or check the parameter values.",
        )


def _notes(flat: FlatModel, is_affine: bool, point: OperatingPoint) -> tuple[str, ...]:
    notes = []
    if not is_affine and not point.is_given:
        notes.append(
            "The model is nonlinear: these are its matrices at the start values "
            "(--at gives another operating point)."
        )
    if ca.depends_on(ca.vertcat(flat.residual, flat.output_expressions), flat.time):
        notes.append(
            f"The equations contain the time: these are the matrices at t = {point.time:g} s "
            "(`time` of the operating point, --at)."
        )
    return tuple(notes)


def _lost_slopes(flat: FlatModel, values: np.ndarray, point: OperatingPoint) -> tuple[str, ...]:
    """A note on each equation and output with a slope that is infinite at the operating point and counts as
    zero, as that of sign(x)*sqrt(abs(x)) does at zero, where CasADi multiplies an infinite slope by zero."""
    laws = ca.vertcat(flat.residual, flat.output_expressions)
    symbols = ca.vertcat(flat.derivatives, flat.xi, flat.u)
    rest = ca.vertcat(flat.w, flat.theta, flat.time)
    here = np.concatenate([point.derivatives, point.xi, point.u])
    others = np.concatenate([np.zeros(len(flat.noises)), values, [point.time]])
    # In numbers zero times infinity is undefined. One direction in which nothing cancels finds most models
    # to have nothing of the kind.
    direction = np.linspace(1.0, 2.0, here.size)
    along = ca.Function("along", [symbols, rest], [ca.jtimes(laws, symbols, ca.SX(direction))])
    rows = np.flatnonzero(np.isnan(along(here, others).full().ravel())).tolist()
    if not rows:
        return ()
    slopes = ca.Function("slopes", [symbols, rest], [ca.jacobian(laws[rows], symbols)])
    step = direction * np.where(here == 0.0, 1.0, np.abs(here))
    near, nearer = (np.abs(slopes(here + share * step, others).full()) for share in BESIDE)
    lost = np.isnan(slopes(here, others).full()) & (nearer > near)
    names = (*(f"der({v.name})" for v in flat.unknowns), *(v.name for v in (*flat.unknowns, *flat.inputs)))
    texts = [*(one.text for one in flat.equations), *(y.name for y in flat.outputs)]
    where = "operating point" if point.is_given else "start values"
    return tuple(
        f"`{texts[row]}` has no finite slope over {', '.join(names[i] for i in np.flatnonzero(over))} at the "
        f"{where}, and counts as if it did not depend on it: give a point beside it (--at)."
        for row, over in zip(rows, lost, strict=True)
        if over.any()
    )


@singledispatch
def has_affine_dynamics(explicit: Dynamics) -> bool:
    """True when ẋ = f and y are affine in (x, u, v, w) with coefficients that do not depend on time. Exact.

    Less than `is_affine_model` asks: an unknown that parameters settle is no signal, though others are
    multiplied by it (a resistance at a fixed temperature), and one that no state and no output reads may be
    any function (the power that is lost in a damper)."""
    raise NotImplementedError(type(explicit).__name__)


@has_affine_dynamics.register
def _has_affine_laws(explicit: ExplicitModel) -> bool:
    flat = explicit.flat
    if flat.events is not None:
        return False
    if is_affine_model(flat):
        return True
    if not explicit.is_symbolic:
        return False
    arguments = explicit.rhs.sx_in()
    *signals, _, time = arguments
    laws = ca.vertcat(explicit.rhs(*arguments), explicit.outputs(*arguments))
    return is_affine(laws, ca.vertcat(*signals), time)
