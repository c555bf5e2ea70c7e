"""ExplicitModel: the index-reduced form ẋ = f(x, u, u̇, …, w, θ, t) of a FlatModel, with every internal
variable."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from daest.model.flat import FlatModel


@dataclass(frozen=True)
class InputDerivative:
    """The `order`-th time derivative of input `index`, which the index reduction needs as an extra input."""

    index: int
    order: int


@dataclass(frozen=True)
class ExplicitModel:
    """States chosen by index reduction, and functions of them.

    The argument vector of all functions is `(x, u, v, w, theta, t)`: x (n_states,), inputs u, input
    derivatives v (`input_derivatives`, may be empty), white noises w, all parameters theta, scalar time t.
    Every function is a CasADi function with exact derivatives.

    `rhs` returns ẋ (n_states,); `variables` returns ξ (n,); `variable_derivatives` returns ξ' (n,) where the
    model determines it without differentiating the inputs further (NaN otherwise); `outputs` returns y.
    `is_symbolic` is True when all functions are plain SX expressions (no Newton iteration inside).
    `invariants` returns g (m,): relations g = 0 that tie the states where there are more of them than degrees
    of freedom (`systems.redundant`); None where the states are free.
    """

    flat: FlatModel
    state_names: tuple[str, ...]  # names of unknowns, or `der(name)` for a derivative chosen as a state
    state_units: tuple[str, ...]
    input_derivatives: tuple[InputDerivative, ...]
    rhs: ca.Function
    variables: ca.Function
    variable_derivatives: ca.Function
    outputs: ca.Function
    is_symbolic: bool
    n_differentiations: int  # how many equations were differentiated, counted with multiplicity
    structural_index: int
    largest_loop: int  # unknowns in the largest algebraic loop after tearing, 0 when there is none
    invariants: ca.Function | None = None

    @property
    def n_states(self) -> int:
        return len(self.state_names)
