"""What a model is made of: variables, parameters, noises, outputs and equations, each a scalar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from daest.errors import EstimationError, ModelError, Place
from daest.near import near_names


@dataclass(frozen=True)
class Prior:
    """In the unit of the parameter: a normal density; where the parameter is searched on a logarithmic
    scale a lognormal one with the median `mean` and the relative standard deviation `std / mean`."""

    mean: float
    std: float


def prior_unused(name: str) -> EstimationError:
    """The error for a prior on a parameter that is not estimated."""
    return EstimationError(
        "prior-unused",
        f"{name} has a prior but is not estimated",
        where=name,
        remedy="estimate it, too (estimate = true under [parameters] of daest.toml, or --estimate with the "
        "names of all that are estimated), or leave the prior out",
    )


@dataclass(frozen=True)
class Variable:
    """A scalar unknown or input. `start` is None where the source gives none; `unit` is Modelica's
    spelling; `guess` is what a recording tells of its value, from where loops of equations are solved.
    `state_select` is that of Modelica; of what was added to a model, such as a load, "kept" asks more than
    the "always" of the model's own variables."""

    name: str
    unit: str = ""
    description: str = ""
    start: float | None = None
    fixed: bool = False
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    is_flow: bool = False
    state_select: Literal["never", "avoid", "default", "prefer", "always", "kept"] = "default"
    place: Place | None = None
    guess: float | None = None

    @property
    def start_or_zero(self) -> float:
        """The start value, 0 where the source gives none."""
        return 0.0 if self.start is None else self.start


@dataclass(frozen=True)
class Parameter:
    """A scalar parameter θ_i. `estimate` marks an unknown one; `scale` is the scale the search works in;
    `null` is where the effect vanishes whose size it is."""

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
    null: float | None = None
    is_memory: bool = False  # no parameter of the source: what keeps its value between events


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


class Named:
    """The names of unknowns ξ, inputs u, white noises w, parameters θ and outputs y, in their order."""

    unknowns: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    noises: tuple[NoiseInput, ...]
    parameters: tuple[Parameter, ...]
    outputs: tuple[Output, ...]

    @property
    def unknown_names(self) -> tuple[str, ...]:
        return tuple(x.name for x in self.unknowns)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(u.name for u in self.inputs)

    @property
    def noise_names(self) -> tuple[str, ...]:
        return tuple(w.name for w in self.noises)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(y.name for y in self.outputs)

    def parameter_columns(self, names: Sequence[str]) -> list[int]:
        """The positions of parameters among all. Raises ModelError `unknown-parameter`."""
        known = self.parameter_names
        for name in names:
            if name not in known:
                near = near_names(name, known) or known[:8]
                raise ModelError(
                    "unknown-parameter",
                    f"the model has no parameter {name}",
                    remedy=f"there are {', '.join(near)}",
                )
        return [known.index(name) for name in names]
