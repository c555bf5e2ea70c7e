"""State-space matrices as functions of the parameters, and their exact derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, singledispatch
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.model.flat import Dynamics, ExplicitModel, Model
from daest.model.linear import StateSpace, StateSpaceFamily
from daest.near import near_names
from daest.systems.initialize import initial_point
from daest.systems.linearize import has_affine_dynamics, is_affine_model, operating_point
from daest.systems.reduce import dynamics

MATRICES = ("A", "B", "G", "b", "C", "D", "H", "d", "X", "U", "W", "x0")
VECTORS = frozenset({"b", "d", "x0"})
DENSE = 100_000  # entries up to which a matrix is computed with its zeros, which takes less time
CACHED_DERIVATIVES = 32  # (family, names) pairs whose compiled derivative functions are kept


def state_space_family(model: Model | Dynamics, at: Mapping[str, float] | None = None) -> StateSpaceFamily:
    """θ -> matrices of ẋ = A x + B ū + G w + b, y = C x + D ū + H w + d, ξ = X x + U ū + W w + x0, ū = (u,
    v).

    Exact for affine models. A nonlinear model is linearised at the operating point `at` (values of states and
    inputs by name; those not named come from the consistent initial point at the inputs' start values), with
    w = 0, v = 0 and t = 0; the offsets make the linear model exact at that point, for every θ. Where ẋ and y
    are affine (`is_affine` of the result), only ξ depends on that point.

        >>> family = daest.state_space_family(explicit)
        >>> [w.name for w in family.noises]
        ['disturbance.w']
    """
    return family_along(model if isinstance(model, Dynamics) else dynamics(model), at)


@singledispatch
def family_along(explicit: Dynamics, at: Mapping[str, float] | None = None) -> StateSpaceFamily:
    """`state_space_family` of the dynamics of a model."""
    raise NotImplementedError(type(explicit).__name__)


@family_along.register
def _of_equations(explicit: ExplicitModel, at: Mapping[str, float] | None = None) -> StateSpaceFamily:
    flat = explicit.flat
    if is_affine_model(flat):
        x, u, time = np.zeros(explicit.n_states), np.zeros(len(flat.inputs)), 0.0
    else:
        x, u, time = _operating_point(explicit, at)
    return family_of(explicit, _matrix_function(explicit, x, u, time), has_affine_dynamics(explicit))


def family_of(
    explicit: Dynamics,
    matrices: ca.Function,
    is_affine: bool,
    derivatives: Callable[[np.ndarray, tuple[int, ...]], list[np.ndarray]] | None = None,
) -> StateSpaceFamily:
    """The family of an explicit model with its names; the functions as `StateSpaceFamily` has them."""
    flat = explicit.flat
    return StateSpaceFamily(
        state_names=explicit.state_names,
        state_units=explicit.state_units,
        unknowns=flat.unknowns,
        inputs=flat.inputs,
        input_derivatives=tuple((d.index, d.order) for d in explicit.input_derivatives),
        noises=flat.noises,
        outputs=flat.outputs,
        parameters=flat.parameters,
        matrices=matrices,
        is_affine=is_affine,
        derivatives=derivatives,
    )


def _operating_point(
    explicit: ExplicitModel, at: Mapping[str, float] | None
) -> tuple[np.ndarray, np.ndarray, float]:
    """States, inputs and time."""
    point = operating_point(explicit.flat, at)
    at = at or {}
    if all(name in at for name in explicit.state_names):
        return np.array([at[name] for name in explicit.state_names]), point.u, point.time
    x, _ = initial_point(explicit, u0=point.u, t0=point.time)
    states = [at.get(name, value) for name, value in zip(explicit.state_names, x, strict=True)]
    return np.array(states), point.u, point.time


def _matrix_function(explicit: ExplicitModel, x0: np.ndarray, u0: np.ndarray, time: float) -> ca.Function:
    """theta -> (A, B, G, b, C, D, H, d, X, U, W, x0), Jacobians at (x0, u0, v = 0, w = 0, time)."""
    kind: Any = ca.SX if explicit.rhs.is_a("SXFunction") else ca.MX
    arguments = [kind.sym(name, explicit.rhs.size1_in(i)) for i, name in enumerate(explicit.rhs.name_in())]
    x, u, v, w, theta, _ = arguments
    inputs = ca.vertcat(u, v)
    slopes = []
    for function in (explicit.rhs, explicit.outputs, explicit.variables):
        value = function(*arguments)
        by_x, by_input, by_w = (ca.jacobian(value, part) for part in (x, inputs, w))
        offset = value - ca.mtimes(by_x, x) - ca.mtimes(by_input, inputs)
        slopes += [by_x, by_input, by_w, offset]
    general = ca.Function(
        "general", arguments, [ca.densify(part) if part.numel() <= DENSE else part for part in slopes]
    )
    parameter = kind.sym("theta", theta.numel())
    point = [x0, u0, np.zeros(v.numel()), np.zeros(w.numel()), parameter, time]
    return ca.Function("matrices", [parameter], general(*point), ["theta"], list(MATRICES))


def state_space(family: StateSpaceFamily, theta: np.ndarray) -> StateSpace:
    """The matrices at theta, shape (n_parameters,), in the order of `family.parameters`.

    >>> ss = daest.state_space(family, flat.theta_values)
    >>> ss.A.shape, ss.C.shape
    ((4, 4), (2, 4))
    """
    values = dict(zip(MATRICES, (m.full() for m in family.matrices.call([theta])), strict=True))
    for name in VECTORS:
        values[name] = values[name][:, 0]
    return StateSpace(
        state_names=family.state_names,
        input_names=tuple(v.name for v in family.inputs),
        input_derivatives=family.input_derivatives,
        noise_names=tuple(v.name for v in family.noises),
        output_names=tuple(v.name for v in family.outputs),
        unknown_names=tuple(v.name for v in family.unknowns),
        **values,
    )


def state_space_derivatives(
    family: StateSpaceFamily, theta: np.ndarray, names: Sequence[str]
) -> dict[str, np.ndarray]:
    """∂M/∂θ_i for every matrix M of `StateSpace` by name, shape (n_names, *M.shape), exact.

    The derivative function is built at the first call for a family and these names and kept. Raises
    ModelError `unknown-parameter`.
    """
    known = [p.name for p in family.parameters]
    for name in names:
        if name not in known:
            near = near_names(name, known) or known[:8]
            raise ModelError(
                "unknown-parameter",
                f"the model has no parameter {name}",
                remedy=f"there are {', '.join(near)}",
            )
    columns = tuple(known.index(name) for name in names)
    if family.derivatives is not None:
        found = zip(MATRICES, family.derivatives(theta, columns), strict=True)
        return {name: m[:, :, 0] if name in VECTORS else m for name, m in found}
    stacked = _derivative_function(family.matrices, columns)(theta).full().T
    result, start = {}, 0
    for i, name in enumerate(MATRICES):
        n_rows, n_columns = family.matrices.size_out(i)
        part = stacked[:, start : start + n_rows * n_columns]
        start += n_rows * n_columns
        # CasADi stacks columns: the last axis of this reshape runs over rows.
        matrix = part.reshape(len(columns), n_columns, n_rows).transpose(0, 2, 1)
        result[name] = matrix[:, :, 0] if name in VECTORS else matrix
    return result


@lru_cache(maxsize=CACHED_DERIVATIVES)
def _derivative_function(matrices: ca.Function, columns: tuple[int, ...]) -> ca.Function:
    """theta -> Jacobian of all matrix entries, column by column, matrix after matrix, in the chosen
    parameters."""
    kind: Any = ca.SX if matrices.is_a("SXFunction") else ca.MX
    theta = kind.sym("theta", matrices.size1_in(0))
    chosen = kind.sym("chosen", len(columns))
    inserted = kind(theta)
    inserted[list(columns)] = chosen
    stacked = ca.vertcat(*(ca.vec(m) for m in matrices.call([inserted])))
    jacobian = ca.jacobian(stacked, chosen)
    general = ca.Function("general", [chosen, theta], [ca.densify(jacobian)])
    return ca.Function("derivatives", [theta], [general(theta[list(columns)], theta)])
