"""By which time derivatives of its inputs a model moves.

The index reduction asks for the derivative of every input that some variable contains: the rate of a spring
between a road and a wheel, say. Where that variable acts by a coefficient of zero, as it does in a spring
without damping, neither the states nor the outputs depend on the derivative, and the input may be held.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np

from daest.errors import ModelError, Place
from daest.model.flat import Dynamics, ExplicitModel, InputDerivative
from daest.model.holds import Hold, held_inputs
from daest.model.linear import StateSpace
from daest.model.parts import Parameter

KEPT = 256  # answers for functions and zeros that were asked for before


def acting_slopes(
    explicit: Dynamics, estimated: Collection[str] = (), theta: np.ndarray | None = None
) -> tuple[InputDerivative, ...]:
    """The input derivatives on which ẋ or y depend, where those parameters that are zero, by `theta`
    (n_theta,) or in the model, and neither `estimated` nor marked for it stay so."""
    if not explicit.input_derivatives:
        return ()
    zeros = _zeros(explicit.flat.parameters, estimated, theta)
    in_loops = explicit.of_tears if isinstance(explicit, ExplicitModel) else None
    if in_loops is None:
        rows = [_acts(f, explicit.is_symbolic, zeros) for f in (explicit.rhs, explicit.outputs)]
    else:
        # What solves the loops moves with all that these contain.
        rows = [_acts(f, True, zeros) for f in in_loops]
    acts = np.any(np.vstack(rows), axis=0)
    return tuple(d for d, one in zip(explicit.input_derivatives, acts, strict=True) if one)


def refuse_derivatives(explicit: Dynamics, hold: Hold, theta: np.ndarray | None = None) -> None:
    """Raises ModelError `input-derivative-order` or `input-derivative-hold` where the model moves by a
    derivative that the hold does not have, at theta (n_theta,) or, without it, at the values of the model."""
    if not explicit.input_derivatives:
        return
    names = explicit.flat.input_names
    held = held_inputs(hold, names)
    for derivative in acting_slopes(explicit, theta=theta):
        if derivative.order > 1 or held[derivative.index]:
            raise no_input_derivative(names[derivative.index], derivative.order, hold)


def no_input_derivative(
    name: str, order: int, hold: Hold, equations: Iterable[str] = (), where: Place | str | None = None
) -> ModelError:
    """The refusal of a derivative of the input `name` that its samples do not have: of a higher order than
    the first, or of a held input. `equations` are lines that name those with the input; `where` is the place
    of one, else the input."""
    needed = "the model needs the time derivative of "
    if order > 1:
        needed += f"order {order} of input {name}"
        remedy = (
            "a sampled input gives only its slope: let the derivative itself be the input of the model, or "
            "feed the input through a lag"
        )
    else:
        needed += f"input {name}, which a held input ({hold}) does not have"
        remedy = "use first-order hold (--hold foh)"
    lines = list(equations)
    return ModelError(
        "input-derivative-order" if order > 1 else "input-derivative-hold",
        "\n".join([f"{needed}, in", *lines] if lines else [needed]),
        where=name if where is None else where,
        remedy=remedy,
    )


def moved_variables(explicit: Dynamics, inputs: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Which variables ξ (n,) depend on a derivative of the chosen `inputs` (n_u,) of bool."""
    acts = _acts(explicit.variables, explicit.is_symbolic, _zeros(explicit.flat.parameters, (), theta))
    return np.any(acts & inputs[[d.index for d in explicit.input_derivatives]], axis=1)


def acting_slopes_of(ss: StateSpace) -> tuple[tuple[int, int], ...]:
    """The input derivatives of a linear model by which ẋ or y move, as (input, order)."""
    n_v = len(ss.input_derivatives)
    acts = np.any(np.vstack([ss.B, ss.D])[:, ss.B.shape[1] - n_v :] != 0.0, axis=0)
    return tuple(d for d, one in zip(ss.input_derivatives, acts, strict=True) if one)


def theta_in_use(
    parameters: Sequence[Parameter], estimated: Collection[str] = (), theta: np.ndarray | None = None
) -> np.ndarray:
    """Values (n_theta,) with 1 for zeros that are `estimated` or marked for it: they will not stay so."""
    values = [p.value for p in parameters] if theta is None else theta
    pairs = zip(parameters, values, strict=True)
    return np.array([value or float(p.estimate or p.name in estimated) for p, value in pairs])


def slope_note(input_names: Sequence[str], sources: Collection[int]) -> tuple[str, ...]:
    """Why inputs are not held between samples, in one sentence: the model needs the derivatives of the inputs
    with the indices `sources`. Empty where they may be held."""
    if not sources:
        return ()
    names = ", ".join(input_names[i] for i in sorted(set(sources)))
    return (f"not held: the model needs the time derivative of input {names}, which a held input has not",)


def _zeros(
    parameters: Sequence[Parameter], estimated: Collection[str], theta: np.ndarray | None
) -> tuple[int, ...]:
    return tuple(np.flatnonzero(theta_in_use(parameters, estimated, theta) == 0.0).tolist())


@lru_cache(maxsize=KEPT)
def _acts(function: ca.Function, is_symbolic: bool, zeros: tuple[int, ...]) -> np.ndarray:
    """Which results (n_rows,) of a function of the model depend on which input derivative (n_v,), with these
    parameters at zero. A function that iterates may depend on all."""
    if not is_symbolic:
        return np.ones((function.size1_out(0), function.size1_in(2)), dtype=bool)
    arguments = [ca.SX.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]
    theta = ca.SX(arguments[4])
    theta[list(zeros)] = 0.0
    value = function(*arguments[:4], theta, *arguments[5:])
    pattern = ca.jacobian_sparsity(value, arguments[2])
    acts = np.zeros(pattern.shape, dtype=bool)
    acts[tuple(np.array(pattern.get_triplet(), dtype=int).reshape(2, -1))] = True
    return acts
