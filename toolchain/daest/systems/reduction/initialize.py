"""Consistent initial values: states and internal variables that satisfy what the model says about the
start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch

import casadi as ca
import numpy as np

from daest.errors import ModelError, Place
from daest.model.flat import Dynamics, ExplicitModel
from daest.numerics.quiet import native_silence
from daest.systems.reduction.algebraic_start import conditioned_start
from daest.systems.tolerances import SOLVER

MAX_STEPS = 50
MAX_HALVINGS = 12


@dataclass(frozen=True)
class Conditions:
    """Conditions on the `states` at the start, 0 = c(x): `texts` and `places` describe the rows of
    `function`, which maps x to (c, ∂c/∂x); None without any."""

    function: ca.Function | None
    states: tuple[str, ...]
    texts: tuple[str, ...]
    places: tuple[Place | None, ...]


@singledispatch
def initial_point(
    explicit: Dynamics,
    theta: np.ndarray | None = None,
    u0: np.ndarray | None = None,
    v0: np.ndarray | None = None,
    t0: float = 0.0,
    given: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """States x0 (n_states,) and internal variables ξ0 (n,) at time t0 with inputs u0 and input derivatives
    v0.

    Conditions: values `given` by name, fixed start values of all variables, initial equations, and relations
    that tie the states. Freedom that these leave is taken up by the start values of the states (0 where there
    is none), states with a start first. Solved by damped Gauss-Newton steps from the start values; one step
    if the model is affine.

    Defaults: parameter values, start values of the inputs, 0. Raises ModelError `initial-overdetermined` or
    `initial-not-solved`, with the conditions that cannot be met.

        >>> daest.initial_point(explicit, u0=np.array([1.0]))[0].tolist()
        [0.0, 0.0, 0.0, 0.0]
    """
    raise NotImplementedError(type(explicit).__name__)


@initial_point.register
def _of_equations(
    explicit: ExplicitModel,
    theta: np.ndarray | None = None,
    u0: np.ndarray | None = None,
    v0: np.ndarray | None = None,
    t0: float = 0.0,
    given: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    arguments = start_arguments(explicit, theta, u0, v0, t0)
    with native_silence():  # CasADi prints the arguments of an inner iteration that fails
        conditions = _conditions(explicit, dict(given or {}), arguments)
        start, wish = _start_values(explicit, arguments)
        if not np.all(np.isfinite(_evaluate(conditions, start)[0])):
            start = _conditioned(explicit, start, arguments)
        x = _solve(conditions, start, wish)
        try:
            return x, explicit.variables(x, *arguments).full().ravel()
        except RuntimeError as error:
            raise _no_solution(explicit.state_names, x) from error


def begun_beside(
    explicit: ExplicitModel, rows: Sequence[int], states: np.ndarray, u: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Initial values (n_rows,) of the states `rows`, which the initial equations are affine in, beside the
    other `states` (n,), by those conditions alone that move with them; zeros where there are none."""
    if not explicit.flat.initial_equations:
        return np.zeros(len(rows))
    arguments = start_arguments(explicit, None, u, v, 0.0)
    x = states.copy()
    x[rows] = 0.0
    with native_silence():
        residual, slopes = _evaluate(_conditions(explicit, {}, arguments), x)
    asks = np.any(slopes[:, rows] != 0.0, axis=1) & np.isfinite(residual)
    return np.linalg.lstsq(slopes[np.ix_(asks, rows)], -residual[asks], rcond=None)[0]


def _no_solution(names: Sequence[str], x: np.ndarray) -> ModelError:
    """The loops of equations inside the model were not solved with the states x."""
    states = ", ".join(f"{n} = {v:g}" for n, v in zip(names, x, strict=True))
    return ModelError(
        "initial-not-solved",
        "no solution of the nonlinear equations inside the model was found at its start"
        + (f", {states}" if states else ""),
        remedy="give start values nearer to a solution, of these and of what the equations contain",
    )


def start_arguments(
    explicit: Dynamics,
    theta: np.ndarray | None,
    u0: np.ndarray | None,
    v0: np.ndarray | None,
    t0: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Values of (u, v, w, theta, t) with the defaults put in."""
    flat = explicit.flat
    u = np.array([p.start_or_zero for p in flat.inputs]) if u0 is None else np.asarray(u0)
    v = np.zeros(len(explicit.input_derivatives)) if v0 is None else np.asarray(v0)
    return u, v, np.zeros(len(flat.noises)), flat.theta_values if theta is None else np.asarray(theta), t0


def _conditions(explicit: ExplicitModel, given: dict[str, float], arguments: tuple) -> Conditions:
    flat = explicit.flat
    names = flat.unknown_names
    unknown = sorted(set(given) - set(names))
    if unknown:
        raise ModelError("unknown-variable", f"the model has no variable {unknown[0]} to start")
    targets = {names.index(name): value for name, value in given.items()}
    for i, variable in enumerate(flat.unknowns):
        if variable.fixed and i not in targets:
            targets[i] = variable.start_or_zero
    if not targets and not flat.initial_equations and explicit.invariants is None:
        return Conditions(None, tuple(explicit.state_names), (), ())
    x = ca.MX.sym("x", explicit.n_states)
    variables = explicit.variables(x, *arguments)
    rows = [variables[i] - value for i, value in targets.items()]
    texts = [f"{names[i]} = {value:g}" for i, value in targets.items()]
    places = [flat.unknowns[i].place for i in targets]
    if flat.initial_equations:
        rows.append(_initial_residual(explicit, x, variables, arguments))
        texts += [equation.text for equation in flat.initial_equations]
        places += [equation.place for equation in flat.initial_equations]
    if explicit.invariants is not None:
        tied = explicit.invariants(x, *arguments)
        rows.append(tied)
        texts += [
            f"constraint {i + 1} between {', '.join(explicit.state_names)}" for i in range(tied.numel())
        ]
        places += [None] * tied.numel()
    stacked = ca.vertcat(ca.MX(0, 1), *rows)
    function = ca.Function("conditions", [x], [ca.densify(stacked), ca.densify(ca.jacobian(stacked, x))])
    return Conditions(function, tuple(explicit.state_names), tuple(texts), tuple(places))


def _initial_residual(explicit: ExplicitModel, x: ca.MX, variables: ca.MX, arguments: tuple) -> ca.MX:
    flat = explicit.flat
    symbols = [flat.derivatives, flat.xi, flat.u, flat.w, flat.theta, flat.time]
    residual = ca.Function("initial", symbols, [flat.initial_residual])
    u, _, w, theta, t = arguments
    rates = explicit.variable_derivatives(x, *arguments)
    used = sorted(set(ca.jacobian_sparsity(flat.initial_residual, flat.derivatives).get_triplet()[1]))
    # Derivatives that no initial equation uses may be undefined (NaN) and must not spoil the Jacobian.
    clean = ca.MX.zeros(len(flat.unknowns))
    if used:
        clean[used] = rates[used]
    return residual(clean, variables, u, w, theta, t)


def _start_values(explicit: ExplicitModel, arguments: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Start value of every state, and its rank as a wish: 2 own start, 1 start of an alias, 0 none."""
    unknowns = explicit.flat.unknowns
    by_name = {v.name: v.start for v in unknowns}
    starts = [by_name.get(name) for name in explicit.state_names]
    value = np.array([0.0 if s is None else s for s in starts])
    wish = np.array([0 if s is None else 2 for s in starts])
    if np.all(wish == 2):  # no alias is asked
        return value, wish
    x = ca.MX.sym("x", explicit.n_states)
    slopes = ca.jacobian(explicit.variables(x, *arguments), x)
    try:
        share = ca.Function("share", [x], [ca.densify(slopes)])(value).full()
    except RuntimeError:  # a loop has no solution there: the other conditions may lead to where it has one
        return value, wish
    for i, variable in enumerate(unknowns):
        states = np.flatnonzero(share[i])
        if variable.start is not None and states.size == 1 and wish[states[0]] == 0:
            (j,) = states
            if abs(share[i, j]) == 1.0:
                value[j], wish[j] = variable.start * share[i, j], 1
    return value, wish


def _conditioned(explicit: ExplicitModel, start: np.ndarray, arguments: tuple) -> np.ndarray:
    """The start values of the states with those in their place that follow one by one from what is fixed and
    from the initial equations: a tank whose mass is 0 has no temperature, but its mass follows from its
    level."""
    flat = explicit.flat
    u, _, _, theta, t = arguments
    declared = np.array([v.start_or_zero for v in flat.unknowns])
    point, is_known = conditioned_start(flat, declared, u, theta, t)
    number = {v.name: i for i, v in enumerate(flat.unknowns)}
    found = start.copy()
    for j, name in enumerate(explicit.state_names):
        i = number.get(name, -1)
        if i >= 0 and is_known[i] and np.isfinite(point[i]):
            found[j] = point[i]
    return found


def _solve(conditions: Conditions, start: np.ndarray, wish: np.ndarray) -> np.ndarray:
    if not conditions.texts:
        return start
    x = start
    residual, slopes = _evaluate(conditions, x)
    free = _free_states(slopes, wish)
    for _ in range(MAX_STEPS):
        if _satisfied(residual, slopes, x):
            return x
        step = _gauss_newton_step(residual, slopes, free, x - start)
        moved = _damped(conditions, x, step, residual)
        if moved is None:
            break
        x, residual, slopes = moved
    raise _unsolved(conditions, residual, slopes, x)


def _evaluate(conditions: Conditions, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """c and its Jacobian; infinite where an inner Newton iteration fails."""
    if conditions.function is None:
        return np.zeros(0), np.zeros((0, x.size))
    try:
        residual, slopes = conditions.function(x)
    except RuntimeError:
        return np.full(len(conditions.texts), np.inf), np.zeros((len(conditions.texts), x.size))
    return residual.full().ravel(), np.nan_to_num(slopes.full())


def _free_states(slopes: np.ndarray, wish: np.ndarray) -> np.ndarray:
    """States that keep their start value: as many as the conditions leave free, the strongest wishes
    first."""
    null = _rank_and_null_space(slopes)[1]
    free: list[int] = []
    for j in sorted(range(wish.size), key=lambda j: (-wish[j], j)):
        norm = float(np.linalg.norm(null[j])) if null.size else 0.0
        if norm > SOLVER.independent_conditions:
            free.append(j)
            direction = null[j] / norm
            null = null - np.outer(null @ direction, direction)
    return np.array(sorted(free), dtype=int)


def _rank_and_null_space(slopes: np.ndarray) -> tuple[int, np.ndarray]:
    """Rank, and a basis (n_states, n_states - rank) of the directions that change no condition."""
    size = np.abs(slopes).max(axis=1, initial=0.0)
    _, singular, right = np.linalg.svd(slopes[size > 0] / size[size > 0, None])
    rank = int(np.sum(singular > SOLVER.independent_conditions * max(slopes.shape)))
    return rank, right[rank:].T


def _gauss_newton_step(
    residual: np.ndarray, slopes: np.ndarray, free: np.ndarray, moved: np.ndarray
) -> np.ndarray:
    size = np.abs(slopes).max(axis=1, initial=0.0)
    scale = np.where(size > 0, size, 1.0)
    hold = np.eye(slopes.shape[1])[free]
    matrix = np.vstack([slopes / scale[:, None], hold])
    return np.linalg.lstsq(matrix, -np.concatenate([residual / scale, moved[free]]), rcond=None)[0]


def _damped(
    conditions: Conditions, x: np.ndarray, step: np.ndarray, residual: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The first of the steps 1, 1/2, 1/4 … that makes the conditions better satisfied; None if none does."""
    before = np.linalg.norm(residual) if np.all(np.isfinite(residual)) else np.inf
    for _ in range(MAX_HALVINGS):
        candidate, slopes = _evaluate(conditions, x + step)
        if np.all(np.isfinite(candidate)) and np.linalg.norm(candidate) < before:
            return x + step, candidate, slopes
        step = step / 2
    return None


def _condition_size(slopes: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.maximum(np.abs(slopes) @ np.abs(x), 1.0)


def _satisfied(residual: np.ndarray, slopes: np.ndarray, x: np.ndarray) -> bool:
    return bool(np.all(np.abs(residual) <= SOLVER.initial_condition * _condition_size(slopes, x)))


def _unsolved(conditions: Conditions, residual: np.ndarray, slopes: np.ndarray, x: np.ndarray) -> ModelError:
    if not np.any(np.isfinite(residual)):
        return _no_solution(conditions.states, x)
    bad = np.flatnonzero(~(np.abs(residual) <= SOLVER.initial_condition * _condition_size(slopes, x)))
    rank = _rank_and_null_space(slopes)[0]
    lines = [f"    {conditions.texts[i]}  (off by {residual[i]:.3g})" for i in bad]
    where = next((conditions.places[i] for i in bad if conditions.places[i] is not None), None)
    if rank < len(conditions.texts):
        free = f"{rank} of the {len(conditions.texts)} conditions are independent"
        return ModelError(
            "initial-overdetermined",
            "\n".join([f"the start values and initial equations contradict each other ({free}):", *lines]),
            where=where,
            remedy="remove `fixed = true` or an initial equation where a constraint ties the variables",
        )
    return ModelError(
        "initial-not-solved",
        "\n".join(["no initial state satisfies the start values and initial equations:", *lines]),
        where=where,
        remedy="give start values nearer to the solution",
    )
