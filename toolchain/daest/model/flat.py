"""FlatModel: the equation list of a Modelica model, F(ξ', ξ, u, w, θ, t) = 0 and y = h(ξ, u, w, θ, t).

Gerdin & Schön (1). One scalar equation per row, each with its text, its origin and its source line.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import casadi as ca
import numpy as np

from daest.errors import Place
from daest.model.given import GivenForm
from daest.model.prior import Prior


@dataclass(frozen=True)
class Variable:
    """A scalar unknown or input. `start` is None where the source gives none; `unit` is Modelica's
    spelling."""

    name: str
    unit: str = ""
    description: str = ""
    start: float | None = None
    fixed: bool = False
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    is_flow: bool = False
    state_select: Literal["never", "avoid", "default", "prefer", "always"] = "default"
    place: Place | None = None


@dataclass(frozen=True)
class Parameter:
    """A scalar parameter θ_i. `estimate` marks an unknown one; `scale` is the scale the search works in."""

    name: str
    value: float
    unit: str = ""
    description: str = ""
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    estimate: bool = False
    scale: Literal["auto", "linear", "log"] = "auto"
    place: Place | None = None
    prior: Prior | None = None


@dataclass(frozen=True)
class DerivedParameter:
    """A parameter that the source computes from others (`J2 = J1/2`): reported, not tunable."""

    name: str
    expression: str
    unit: str = ""
    description: str = ""
    place: Place | None = None


@dataclass(frozen=True)
class NoiseInput:
    """A scalar white noise w_i. `intensity` is its two-sided spectral density, [unit]² s: E w(t) w(s) =
    intensity δ(t-s). None means that the source gives none."""

    name: str
    intensity: float | None = None
    unit: str = ""
    description: str = ""
    estimate: bool = False
    place: Place | None = None
    intensity_parameter: str = ""  # name of the parameter that holds the intensity, if one does


@dataclass(frozen=True)
class Output:
    """A scalar measured output y_i = h_i(ξ, u, w, θ, t) + e_i; `noise_std` is the standard deviation of one
    sample of e_i, in the unit of the output, None where the source gives none."""

    name: str
    unit: str = ""
    description: str = ""
    noise_std: float | None = None
    estimate_noise: bool = True
    place: Place | None = None
    noise_std_parameter: str = ""  # name of the parameter that holds the standard deviation, if one does


@dataclass(frozen=True)
class Equation:
    """A scalar equation. `text` is readable Modelica (`J*a = flange_a.tau + flange_b.tau`); `kind` tells
    where it comes from, `origin` names the component, or the connectors of a connection."""

    text: str
    kind: Literal["component", "connection", "flow", "unconnected", "binding"]
    origin: str
    place: Place | None = None


@dataclass(frozen=True)
class FlatModel:
    """The DAE of a model, scalar by scalar, with CasADi SX expressions.

    `residual` (n×1) holds one row per entry of `equations`, in the symbols `derivatives` (ξ', n×1), `xi`
    (n×1), `u`, `w`, `theta` and `time`. Row signs are those of `lhs - rhs` of the source. n equations, n
    unknowns: a top-level output that only names an expression, y = h(ξ), is no unknown; it stands in
    `output_expressions` as in (1b) of the report. `initial_residual` are the initial equations, in the same
    symbols; fixed start values are told by `Variable.fixed`. `given` takes the place of equations that
    nobody has.
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
