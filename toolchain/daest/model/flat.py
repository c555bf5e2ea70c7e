"""FlatModel: the equation list of a Modelica model, F(ξ', ξ, u, w, θ, t) = 0 and y = h(ξ, u, w, θ, t); and
ExplicitModel, its index-reduced form.

Gerdin & Schön (1). One scalar equation per row, each with its text, its origin and its source line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.model.events import Events
from daest.model.linear import LinearDAE, StateSpaceFamily
from daest.model.parts import DerivedParameter, Equation, NoiseInput, Output, Parameter, Variable


@dataclass(frozen=True)
class FlatModel:
    """The DAE of a model, scalar by scalar, with CasADi SX expressions.

    `residual` (n×1) holds one row per entry of `equations`, in the symbols `derivatives` (ξ', n×1), `xi`
    (n×1), `u`, `w`, `theta` and `time`. Row signs are those of `lhs - rhs` of the source. n equations, n
    unknowns: a top-level output that only names an expression, y = h(ξ), is no unknown; it stands in
    `output_expressions` as in (1b) of the report. `initial_residual` are the initial equations, in the same
    symbols; fixed start values are told by `Variable.fixed`. `given` takes the place of equations that
    nobody has. `events`: what happens when; None for a model that is smooth, or whose switches need no
    memory.
    """

    name: str
    unknowns: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    noises: tuple[NoiseInput, ...]
    parameters: tuple[Parameter, ...]
    outputs: tuple[Output, ...]
    equations: tuple[Equation, ...]
    derivatives: ca.SX
    xi: ca.SX
    u: ca.SX
    w: ca.SX
    theta: ca.SX
    time: ca.SX
    residual: ca.SX
    output_expressions: ca.SX
    initial_equations: tuple[Equation, ...] = ()
    initial_residual: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    derived_parameters: tuple[DerivedParameter, ...] = ()
    derived_values: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    source: str = ""
    description: str = ""
    given: GivenForm | None = None
    events: Events | None = None

    def __post_init__(self) -> None:
        sizes = {
            "derivatives": (self.derivatives, len(self.unknowns)),
            "xi": (self.xi, len(self.unknowns)),
            "u": (self.u, len(self.inputs)),
            "w": (self.w, len(self.noises)),
            "theta": (self.theta, len(self.parameters)),
            "residual": (self.residual, len(self.equations)),
            "output_expressions": (self.output_expressions, len(self.outputs)),
            "initial_residual": (self.initial_residual, len(self.initial_equations)),
            "derived_values": (self.derived_values, len(self.derived_parameters)),
        }
        for name, (expression, size) in sizes.items():
            if expression.numel() != size:
                raise ValueError(f"FlatModel.{name} has {expression.numel()} rows, expected {size}")
        if len(self.equations) != len(self.unknowns):
            raise ValueError(f"{len(self.equations)} equations for {len(self.unknowns)} unknowns")

    @property
    def n(self) -> int:
        """Number of equations and unknowns."""
        return len(self.unknowns)

    @property
    def theta_values(self) -> np.ndarray:
        """Values of all parameters, shape (n_parameters,)."""
        return np.array([p.value for p in self.parameters])

    def with_theta(self, theta: Mapping[str, float]) -> FlatModel:
        """The model with these parameter values; names present in only one of both are ignored."""
        parameters = tuple(replace(p, value=theta.get(p.name, p.value)) for p in self.parameters)
        return replace(self, parameters=parameters)

    def checked_theta(self, theta: np.ndarray | None) -> np.ndarray:
        """`theta` (n_theta,), or the values of the model for None. Raises ValueError for another shape and
        ModelError `parameter-outside-bounds` for a value that is not finite."""
        values = self.theta_values if theta is None else np.asarray(theta, dtype=float)
        if values.shape != (len(self.parameters),):
            raise ValueError(f"theta has shape {values.shape}, expected {(len(self.parameters),)}")
        for parameter, value in zip(self.parameters, values, strict=True):
            if not np.isfinite(value):
                raise ModelError(
                    "parameter-outside-bounds",
                    f"parameter `{parameter.name}`: {value} is not a finite number",
                    where=parameter.place,
                    remedy="Choose a finite value.",
                )
        return values


@dataclass(frozen=True)
class InputDerivative:
    """The `order`-th time derivative of input `index`, which the index reduction needs as an extra input."""

    index: int
    order: int


@dataclass(frozen=True)
class ExplicitModel:
    """The form ẋ = f(x, u, u̇, …, w, θ, t) of a `FlatModel`: states chosen by index reduction, and functions
    of them.

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


class GivenForm(Protocol):
    """The form in which a model is given from outside, such as the binary of an FMU.

    Its `FlatModel` has names, units and values, and NaN for every residual: each step that would take its
    functions from the equations asks here. `hides_states`: only simulations can be had.
    """

    hides_states: bool

    @property
    def may_jump(self) -> bool:
        """True if the results may depend on more than time, states and inputs: on discrete variables that
        events have changed, or on integrator steps that were reported to the model."""

    @property
    def method(self) -> str:
        """How simulations are computed."""

    @property
    def is_affine(self) -> bool: ...

    def has_affine_dynamics(self, flat: FlatModel) -> bool:
        """True if the rates and the outputs are affine in states and inputs; other variables need not be."""

    def with_noises(self, flat: FlatModel, noises: Mapping[str, float | None]) -> FlatModel:
        """The model with white noise of the given intensities at its places, by name."""

    def explicit(self, flat: FlatModel) -> ExplicitModel: ...

    def linearize(self, flat: FlatModel, theta: np.ndarray, at: Mapping[str, float] | None) -> LinearDAE: ...

    def family(self, flat: FlatModel, at: Mapping[str, float] | None) -> StateSpaceFamily: ...

    def start(
        self, flat: FlatModel, theta: np.ndarray, u: np.ndarray, time: float, given: Mapping[str, float]
    ) -> np.ndarray:
        """Initial states (n_states,)."""

    def integrate(
        self, flat: FlatModel, names: tuple[str, ...], drive: Any, options: Mapping[str, Any]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States, outputs and sensitivities as in `systems.integrate.Trajectory`."""

    def variables_along(
        self,
        flat: FlatModel,
        time: np.ndarray,
        ubar: np.ndarray,
        theta: np.ndarray,
        states: np.ndarray,
        hold: Literal["zoh", "foh"],
    ) -> np.ndarray:
        """All internal variables (n_samples, n) along states (n_samples, n_states)."""

    def raise_failure(self) -> None:
        """Raise the error that a CasADi function of `explicit` met; its value was NaN."""

    def local_functions(self, flat: FlatModel) -> tuple[Any, Any]:
        """`flow` and `see` of `systems.local_linear.LocalModel`."""


def events_refused(what: str) -> ModelError:
    """The error for what needs a model without events; `what` is the task, as a noun."""
    return ModelError(
        "events-not-supported",
        f"the model changes at events (when, reinit, pre, sample), which {what} does not follow",
        remedy="`simulate` follows events, `linearize` and `noise` take the mode of the start. Else describe "
        "the switch by a smooth equation (tanh(x/width) for sign(x)), or export the model by your own tool "
        "as an FMU, which knows its events.",
    )
