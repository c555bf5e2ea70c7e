"""The states of a model with effects attached, from the states of the model without them.

The grown model may choose other states among variables that are proportional to each other (both sides of a
gear, say). An effect that asks for an angle where the model has only a speed brings it along as a state: the
integral of that speed, from zero. An effect may also have states of its own (the deflection of bristles, the
place on a loop): at size zero they follow the model and act on nothing, so that they can be known along its
motion, too, where their rates are linear in them, or where each moves itself alone.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

import casadi as ca
import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import expm

from daest.errors import EstimationError
from daest.model.flat import ExplicitModel
from daest.numerics.evaluator import along, repeated
from daest.numerics.recursions import linear_recursion
from daest.systems.reduction.initialize import begun_beside

LARGEST_GROWTH = 30.0  # of a state over a sample, by a factor e
STEP_DECIMALS = 9  # of a step in the usual one, to which steps are the same
Inputs = tuple[np.ndarray, np.ndarray]  # u (n_u, n_samples) and v (n_v, n_samples)


@dataclass(frozen=True)
class GrownStates:
    """`common` rows of the states of `explicit` are T (n, n) times the states of the model without effects;
    the `brought` ones are integrals of what the others and they themselves determine, from where initial
    equations of the effects ask for, else from zero."""

    explicit: ExplicitModel
    T: np.ndarray
    common: list[int]
    brought: list[int]

    def along(self, time: np.ndarray, states: np.ndarray, inputs: Inputs) -> np.ndarray:
        """States (n_samples, n_grown) of `explicit` along the states (n_samples, n) without effects."""
        grown = np.zeros((states.shape[0], self.explicit.n_states))
        grown[:, self.common] = states @ self.T.T
        return with_integrals(self.explicit, self.brought, time, grown, inputs)

    def rows_without_effects(self) -> np.ndarray:
        """(n_grown, n): a row of rates of `explicit` times this is the row of those of the model without
        effects."""
        rows = np.zeros((self.explicit.n_states, len(self.common)))
        rows[self.common] = np.linalg.inv(self.T).T
        return rows


def with_integrals(
    explicit: ExplicitModel, rows: list[int], time: np.ndarray, states: np.ndarray, inputs: Inputs
) -> np.ndarray:
    """`states` (n_samples, n) with the integrals of their rates, from where initial equations ask for, else
    from zero, in the columns `rows`, as `brought_rows` tells them: each rate is a + b x in its own state x,
    any function of that, or a + B x with a constant B among states that move each other."""
    if not rows:
        return states
    result = states.copy()
    result[:, rows] = 0.0
    u, v = (part[:, 0] for part in inputs)
    starts = begun_beside(explicit, rows, result[0], u, v)
    arguments, rates, slopes = _rates_among(explicit, rows)
    law = ca.Function("rates", arguments, [ca.densify(part) for part in (rates, ca.diag(slopes))])
    w = np.zeros(explicit.rhs.numel_in(3))
    columns = [result, *(part.T for part in inputs), w, time[:, None]]
    a, b = (np.ascontiguousarray(part.T) for part in along(law, columns))
    alone, together = _apart(slopes)
    bent = _bent(arguments, slopes, rows)
    straight = [i for i in alone if i not in bent]
    result[:, [rows[i] for i in straight]] = _integrals(time, a[straight], b[straight], starts[straight])
    if bent:
        chosen = [rows[i] for i in bent]
        own = ca.Function("own", arguments, [rates[bent], ca.diag(slopes)[bent]])
        result[:, chosen] = _bent_motion(own, chosen, columns, starts[bent])
    if together:
        among = ca.Function("among", arguments, [slopes[together, together]])
        B = np.array(among(*(np.zeros(argument.numel()) for argument in arguments)))
        result[:, [rows[i] for i in together]] = _linear_motion(time, a[together], B, starts[together])
    return result


def _integrals(time: np.ndarray, a: np.ndarray, b: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """x (n_samples, n) of x' = a + b x from `starts` (n,), with a and b (n, n_samples); exact where they are
    constant over an interval."""
    if not np.any(b):
        return starts + np.asarray(cumulative_trapezoid(a, time, axis=1, initial=0.0)).T
    a, b = (0.5 * (part[:, 1:] + part[:, :-1]) for part in (a, b))
    grows = np.diff(time) * b
    shares = np.where(grows == 0.0, 1.0, np.expm1(grows) / np.where(grows == 0.0, 1.0, grows))
    added, kept = np.diff(time) * shares * a, np.exp(grows)
    x = np.zeros((time.size, a.shape[0]))
    x[0] = starts
    for k in range(time.size - 1):
        x[k + 1] = kept[:, k] * x[k] + added[:, k]
    return x


def _bent_motion(
    law: ca.Function, rows: Sequence[int], columns: Sequence[np.ndarray], starts: np.ndarray
) -> np.ndarray:
    """The states `rows` (n_samples, n) from `starts` (n,), of which the `law` tells rates and own slopes,
    each (n,), beside the other arguments, `columns` (n_samples, n_argument): over an interval as straight as
    at its start, with what moves them as in its middle (exponential Rosenbrock-Euler method)."""
    steps = np.diff(columns[-1], axis=0)
    middles = [0.5 * (part[1:] + part[:-1]) if part.ndim == 2 else part for part in columns]
    x = ca.MX.sym("x", len(rows))
    given = [ca.MX.sym("given", law.numel_in(i)) for i in range(law.n_in())]
    step, state = ca.MX.sym("step"), ca.MX(given[0])
    state[list(rows)] = x
    rate, slope = law(state, *given[1:])
    grows = ca.fmin(step * slope, LARGEST_GROWTH)
    flat = ca.fabs(grows) < np.sqrt(np.finfo(float).eps)
    share = ca.if_else(flat, 1.0, (ca.exp(grows) - 1.0) / ca.if_else(flat, 1.0, grows))
    over = ca.Function("over", [x, step, *given], [ca.densify(x + step * share * rate)])
    with suppress(RuntimeError):
        over = over.expand()
    return repeated(over, starts, [steps, *middles])


def _linear_motion(time: np.ndarray, a: np.ndarray, B: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """x (n_samples, n) of x' = a + B x from `starts` (n,), with a (n, n_samples) and B (n, n); exact where a
    is constant over an interval."""
    n = B.shape[0]
    usual = float(np.median(np.diff(time)))
    steps, which = np.unique(np.round(np.diff(time) / usual, STEP_DECIMALS), return_inverse=True)
    over = [expm(step * usual * np.block([[B, np.eye(n)], [np.zeros((n, 2 * n))]])) for step in steps]
    means = 0.5 * (a[:, 1:] + a[:, :-1])
    if len(over) == 1:
        return linear_recursion(over[0][:n, :n], means.T @ over[0][:n, n:].T, starts)
    x = np.zeros((time.size, n))
    x[0] = starts
    for k, one in enumerate(which):
        x[k + 1] = over[one][:n, :n] @ x[k] + over[one][:n, n:] @ means[:, k]
    return x


def brought_rows(explicit: ExplicitModel, known: Collection[str]) -> list[int]:
    """Rows of the states without a `known` name, where each moves itself alone, or their rates are linear in
    them and those that move each other do so by constants; else none. All at the parameters of the model: an
    effect of size zero moves nothing."""
    new = [i for i, name in enumerate(explicit.state_names) if name not in known]
    if not new:
        return []
    arguments, _, slopes = _rates_among(explicit, new)
    alone, together = _apart(slopes)
    if not set(_bent(arguments, slopes, new)) <= set(alone):
        return []
    among = ca.vec(slopes[together, together])
    is_constant = not together or not any(ca.which_depends(among, ca.vertcat(*arguments), 1, True))
    return new if is_constant else []


def _bent(arguments: list[Any], slopes: Any, rows: Sequence[int]) -> list[int]:
    """Places in the states `rows` of those over which slopes change: rates are not linear in them."""
    bent_by = ca.which_depends(ca.vec(slopes), arguments[0], 1, False)
    return [i for i, row in enumerate(rows) if bent_by[row]]


def _apart(slopes: Any) -> tuple[list[int], list[int]]:
    """Places in the states of `_rates_among` of those that no other one moves or is moved by, and of the
    rest."""
    moved_by = ca.DM(slopes.sparsity(), 1.0).full()
    among = moved_by - np.diag(np.diag(moved_by))
    is_alone = ~(np.any(among, axis=0) | np.any(among, axis=1))
    return np.flatnonzero(is_alone).tolist(), np.flatnonzero(~is_alone).tolist()


def _rates_among(explicit: ExplicitModel, rows: list[int]) -> tuple[list[Any], Any, Any]:
    """(x, u, v, w, t) as symbols, the rates of the states `rows` and their slopes over them, at the
    parameters of the model; without what is multiplied by a parameter of zero, where the equations are no
    loops that are solved by iterations."""
    rhs, names = explicit.rhs, [explicit.rhs.name_in(i) for i in range(explicit.rhs.n_in())]
    symbols: Any = ca.MX
    with suppress(RuntimeError):
        rhs, symbols = rhs.expand(), ca.SX
    x, u, v, w, t = (symbols.sym(names[i], rhs.numel_in(i)) for i in (0, 1, 2, 3, 5))
    rates = rhs(x, u, v, w, symbols(explicit.flat.theta_values), t)
    return [x, u, v, w, t], rates[rows], ca.jacobian(rates, x)[rows, rows]


def grown_states(
    own: ExplicitModel, theta: np.ndarray, at: np.ndarray, inputs: np.ndarray, explicit: ExplicitModel
) -> GrownStates:
    """How the states of `explicit` follow from those of `own`, at its states `at` (n,) and `inputs` (n_u,): a
    loop of equations may have no solution without these.

    Raises EstimationError `diagnose-no-candidate` where they do not.
    """
    if explicit.state_names == own.state_names:
        n = own.n_states
        return GrownStates(explicit, np.eye(n), list(range(n)), [])
    x = ca.MX.sym("x", own.n_states)
    point = (x, inputs, *(np.zeros(own.rhs.numel_in(i)) for i in (2, 3)), theta, 0.0)
    values: Any = ca.vertcat(cast(Any, own.variables(*point)), cast(Any, own.variable_derivatives(*point)))
    names = [*own.flat.unknown_names, *(f"der({name})" for name in own.flat.unknown_names)]
    brought = brought_rows(explicit, names)
    common = [i for i in range(explicit.n_states) if i not in brought]
    missing = [explicit.state_names[i] for i in common if explicit.state_names[i] not in names]
    if missing or len(common) != own.n_states:
        raise EstimationError(
            "diagnose-no-candidate",
            "the model with the candidates has other states than the model: "
            + ", ".join(missing or explicit.state_names),
            remedy="restrict the search (--effect, --at)",
        )
    rows = [names.index(explicit.state_names[i]) for i in common]
    slopes = ca.Function("basis", [x], [ca.densify(ca.jacobian(values[rows], x))])
    return GrownStates(explicit, np.array(slopes(at)), common, brought)
