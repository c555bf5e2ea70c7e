"""A model of a machine: `Model` has its names, units and values, a `FlatModel` its equations too, and
`Dynamics` is the form ẋ = f in which a model is driven and filtered.

What models are asked are generic functions (`functools.singledispatch`) of `systems`. Of a `Model`:
`dynamics`, `linearize`, `is_affine_model` and, in `modelica`, `with_noises`. Of its `Dynamics`:
`initial_point`, `integrator`, `values_along`, `family_along`, `local_model`, `has_affine_dynamics`. A new
kind of model is a subclass of both that answers these ten, as `fmu/binary_model.py` does for FMUs that carry
no equations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import casadi as ca
import numpy as np

from daest.errors import FmuError, ModelError
from daest.model.events import Events
from daest.model.parts import DerivedParameter, Equation, Named, NoiseInput, Output, Parameter, Variable


@dataclass(frozen=True, kw_only=True)
class Model(Named):
    """Names, units and values of a model: unknowns ξ, inputs u, white noises w, parameters θ, outputs y.

    `equations` name what holds, one for each unknown, in the words of the source; whether they can be
    evaluated is a matter of the subclass. `events`: what happens when, as far as daest has to follow it; None
    for a model that is smooth, whose switches need no memory, or that follows its events itself.
    """

    name: str
    unknowns: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    noises: tuple[NoiseInput, ...]
    parameters: tuple[Parameter, ...]
    outputs: tuple[Output, ...]
    equations: tuple[Equation, ...]
    derived_parameters: tuple[DerivedParameter, ...] = ()
    source: str = ""
    description: str = ""
    events: Events | None = None

    @property
    def has_equations(self) -> bool:
        """Whether the equations can be evaluated: a `FlatModel`."""
        return isinstance(self, FlatModel)

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.unknowns)

    @property
    def theta_values(self) -> np.ndarray:
        """Values of all parameters, shape (n_parameters,)."""
        return np.array([p.value for p in self.parameters])

    def with_theta(self, theta: Mapping[str, float]) -> Self:
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

    def refuse_hidden_states(self, what: str) -> None:
        """Raise the error for a `what` of a model that can only be simulated, if this is one."""


@dataclass(frozen=True, kw_only=True)
class FlatModel(Model):
    """A model with equations: the DAE F(ξ', ξ, u, w, θ, t) = 0, y = h(ξ, u, w, θ, t), scalar by scalar, with
    CasADi SX expressions. Gerdin & Schön (1).

    `residual` (n×1) holds one row per entry of `equations`, in the symbols `derivatives` (ξ', n×1), `xi`
    (n×1), `u`, `w`, `theta` and `time`. Row signs are those of `lhs - rhs` of the source. n equations, n
    unknowns: a top-level output that only names an expression, y = h(ξ), is no unknown; it stands in
    `output_expressions` as in (1b) of the report. `initial_residual` are the initial equations, in the same
    symbols; fixed start values are told by `Variable.fixed`. `attached` names the effects that were put in.
    """

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
    derived_values: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    attached: frozenset[str] = frozenset()

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


def with_equations(model: Model, what: str) -> FlatModel:
    """The model, if it has equations; FmuError `fmu-no-equations` tells that `what`, a noun, needs them."""
    if isinstance(model, FlatModel):
        return model
    raise FmuError(
        "fmu-no-equations",
        f"{what} needs a model with equations, and this FMU carries none",
        where=model.source or model.name,
        remedy="use the Modelica source, or an FMU of daest export",
    )


@dataclass(frozen=True)
class InputDerivative:
    """The `order`-th time derivative of input `index`, which the index reduction needs as an extra input."""

    index: int
    order: int


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """The form ẋ = f(x, u, u̇, …, w, θ, t) of a model, and functions of its states.

    The argument vector of all functions is `(x, u, v, w, theta, t)`: x (n_states,), inputs u, input
    derivatives v (`input_derivatives`, may be empty), white noises w, all parameters theta, scalar time t.

    `rhs` returns ẋ (n_states,); `variables` returns ξ (n,); `variable_derivatives` returns ξ' (n,) where the
    model determines it without differentiating the inputs further (NaN otherwise); `outputs` returns y.
    `is_symbolic` is True when all functions are plain SX expressions (no Newton iteration inside).
    `invariants` returns g (m,): relations g = 0 that tie the states where there are more of them than degrees
    of freedom (`systems.redundant`); None where the states are free.
    """

    flat: Model
    state_names: tuple[str, ...]  # names of unknowns, or `der(name)` for a derivative chosen as a state
    state_units: tuple[str, ...]
    input_derivatives: tuple[InputDerivative, ...]
    rhs: ca.Function
    variables: ca.Function
    variable_derivatives: ca.Function
    outputs: ca.Function
    is_symbolic: bool
    invariants: ca.Function | None = None

    @property
    def n_states(self) -> int:
        return len(self.state_names)

    @property
    def n_tears(self) -> int:
        """Numbers from which the Newton iterations of algebraic loops start."""
        return 0

    @property
    def may_jump(self) -> bool:
        """True if the functions may depend on more than their arguments: on discrete variables that events
        have changed, or on integrator steps that were reported to the model."""
        return False

    @property
    def check_if_stopped(self) -> str:
        """What else to look at where a simulation stopped, behind the parameters and the inputs at that time;
        from a comma on, or nothing."""
        return ""

    def raise_failure(self) -> None:
        """Raise the error that a function met since the last call; its value was NaN then."""


@dataclass(frozen=True, kw_only=True)
class ExplicitModel(Dynamics):
    """The dynamics of a `FlatModel` by index reduction, with exact derivatives of every function.

    `near` are `rhs` and `outputs`, `near_variables` and `near_derivatives` are `variables` and
    `variable_derivatives` of a model with Newton iterations as functions of (x, u, v, w, theta, t, guess) ->
    (value, tears), the last one -> value: the iterations start from a guess (n_tears,), the tears of a point
    nearby, where it is a number; None where there are none. `of_tears` are `rhs`, `outputs` and the residuals
    (n_tears,) of those iterations as expressions, functions of (x, u, v, w, theta, t, tears); None where a
    loop has too many tears for them to be short.
    """

    flat: FlatModel
    n_differentiations: int  # how many equations were differentiated, counted with multiplicity
    structural_index: int
    largest_loop: int  # unknowns in the largest algebraic loop after tearing, 0 when there is none
    near: tuple[ca.Function, ca.Function] | None = None
    near_variables: ca.Function | None = None
    of_tears: tuple[ca.Function, ca.Function, ca.Function] | None = None
    near_derivatives: ca.Function | None = None

    @property
    def n_tears(self) -> int:
        return 0 if self.near is None else self.near[0].numel_in(6)

    @property
    def check_if_stopped(self) -> str:
        return (
            ", and whether a mass or another coefficient of a derivative becomes zero; round a discontinuity "
            "over a width, as tanh(w/width) for sign(w)"
        )


def events_refused(what: str) -> ModelError:
    """The error for what needs a model without events; `what` is the task, as a noun."""
    return ModelError(
        "events-not-supported",
        f"the model changes at events (when, reinit, pre, sample), which {what} does not follow",
        remedy="`simulate`, `identify`, `compare`, `diagnose` and `filter` follow events, `linearize` and "
        "`noise` take the mode of the start. Else describe the switch by a smooth equation (tanh(x/width) "
        "for sign(x)), or export the model by your own tool as an FMU, which knows its events.",
    )
