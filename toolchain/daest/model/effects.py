"""Effects: physics that a model may lack, as the library describes it, and the places of a model where it
fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from daest.quantities import is_of

Domain = Literal["rotational", "translational", "electrical", "thermal", "hydraulic", "amount", "signal"]
Attachment = Literal["connector", "parallel", "series", "signal", "input", "output", "parameter"]
ParameterRole = Literal["size", "shape", "sharpness", "given"]
PER_TIME = "/time"  # behind a variable: its largest magnitude in the time of the recording
SiteKind = Literal[
    "node",
    "component",
    "pair",
    "connector",
    "equation",
    "exchange",
    "force",
    "mesh",
    "terminal",
    "each",
    "input",
    "output",
    "signal",
    "parameter",
]


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect.

    `role` is "size" (the effect vanishes where all sizes are `null`), "shape" (its form), "sharpness"
    (rounds a kink; not estimated) or "given" (taken from the parameter `given_from` of the component that
    the effect belongs to; `required` if the effect makes no sense without it). `grid` holds values worth
    trying, in multiples of the largest magnitude of the effect's variable `scale_of`, of the duration of the
    recording where that is "time", of its sampling period where that is "sample", of the magnitude of `u` in
    the time of the recording where it is "u/time", or as they are where it is empty. An element of an array
    is called `y[1]`.
    `proof`, such a multiple, is what a refit takes in place of the values that the screen tries: what lets a
    size of nothing be seen may blur one that is there.
    `signal_unit` is "u", "u/s", "1/u" or "1/(u.s)" for a parameter in the unit of the signal or amount that
    the effect sits on, in that per second, in one over it, or in one over it per second; "z" or "1/z" for one
    in the unit of the variable that a parameter changes with, or in one over it.
    `periods_over` is the effect's variable over a period of 2*pi of which the effect repeats as often as the
    parameter says: the screen adds the whole number of periods that the data show to `grid`, or, where they
    show less than a turn, any number, which is then fitted. Where `scale_of` is given, too, the parameter is
    the length of one period along that variable, and the screen adds the one that they show. Over "time" the
    parameter is a period of time: what swings faster than twice in a sample
    is not seen.
    """

    name: str
    unit: str
    description: str
    start: float
    min: float | None
    max: float | None
    null: float | None
    role: ParameterRole
    grid: tuple[float, ...] = ()
    given_from: str = ""
    scale_of: str = ""
    estimate: bool = False
    required: bool = False
    signal_unit: str = ""
    periods_over: str = ""
    proof: float | None = None

    @property
    def is_period_of_time(self) -> bool:
        return self.periods_over == "time"

    @property
    def is_scaled_by_rate(self) -> bool:
        """Whether the grid counts in the largest magnitude of a variable in the time of the recording."""
        return self.scale_of.endswith(PER_TIME)

    @property
    def is_share(self) -> bool:
        """Whether it is a share that begins with all that there can be, from nothing on."""
        return self.max is not None and self.min == self.null and self.start == self.max


@dataclass(frozen=True)
class Effect:
    """A class of the effect library.

    `attach` tells how it is put in: at a "connector" (against the housing, or across a component if it
    `has_support`), "parallel" to a component, in "series" with a connector, between a "signal" and its use
    ("input" or "output" where only one of them makes sense), or at a "parameter". `connectors` are its
    connectors in the order from a to b; those of a signal effect are `u` and `y`. `inputs` are signals that
    must be supplied besides, in `input_units`. `is_dynamic`: the model changes its order or index at the null
    of the sizes, so that no derivative with respect to them exists there. `n_states` counts the effect's own
    states that it has besides those of the motion of its connectors. `outside` tells where it is tried at an
    FMU without equations: at its inputs, at its outputs, or not at all. `sum_of` names the effects that it is
    the sum of: beside all but one of them, it is the one that is left. `grounded` names the effect at one
    connector that it is where an end of its place is grounded, `one_way` the one that it is where all motion
    goes one way. `is_of_store`: it changes a store that the model has, and is nothing where there is none.
    `most_turns`: of a body that it may hold; no spring is wound by one that turns on and on. None where it
    acts at any angle. `is_of_driving`: its further signal is an input that drives the model, and no recorded
    signal that does nothing there. `is_of_gas`: it is tried where what flows may be a gas. `is_of_equation`:
    it is tried at bare equations alone, since between components another effect says the same. `is_rival`:
    others are told from it, and it is tried for itself only where it is named.
    """

    name: str
    class_name: str
    domain: Domain
    attach: Attachment
    law: str
    description: str
    parameters: tuple[EffectParameter, ...]
    connectors: tuple[str, ...]
    is_dynamic: bool
    n_states: int
    has_support: bool = False
    inputs: tuple[str, ...] = ()
    input_units: tuple[str, ...] = ()
    outside: Literal["", "input", "output"] = ""
    sum_of: tuple[str, ...] = ()
    grounded: str = ""
    one_way: str = ""
    is_of_store: bool = False
    most_turns: float | None = None
    is_of_driving: bool = False
    is_of_gas: bool = False
    is_of_equation: bool = False
    is_rival: bool = False
    documentation: str = ""
    libraries: tuple[str, ...] = ()  # folders besides the bundled library that the class was read from

    @property
    def sizes(self) -> tuple[EffectParameter, ...]:
        """The parameters that make the effect vanish."""
        return tuple(p for p in self.parameters if p.role == "size")

    @property
    def is_of_variable(self) -> bool:
        """Whether its further signal is a variable of the model, with which a parameter changes."""
        return self.attach == "parameter" and bool(self.inputs)

    @property
    def is_limit(self) -> bool:
        """Whether it cuts a share of what is beyond its limit."""
        return any(p.is_share for p in self.sizes)

    @property
    def null_values(self) -> dict[str, float]:
        """Values of the sizes at which the effect vanishes."""
        return {p.name: p.null or 0.0 for p in self.sizes}


@dataclass(frozen=True)
class Site:
    """A place of a model where an effect can sit.

    `connectors` are, by `kind`: "node" the connectors at it (those on both sides of a rigid body count as
    one node); "component" and "pair" the two ends a and b; "connector" that connector alone. An "input",
    "output", "parameter" or a "signal" between parts of the model has none, its name is the variable's. An
    "equation" is a balance of a model without connectors, called `7:v` by its index and the variable whose
    rate it gives, in the domain "amount" where its unit belongs to none that is physical; an "exchange" is
    between two such balances of heat or volume, called by both, or between one of heat and an input that is
    a temperature; a "force" acts between the bodies of such balances, or between one and what an input
    moves, or as a spring to what does not move (`is_grounded`), called `4:F` by the equation that gives it
    or by the balances and the input; a "mesh" is a sum of voltages along a path or of pressures along a
    pipe, called `2:i` by its index and its current or flow, `2:R` where the current through a resistance
    has no variable; a "terminal" is an output voltage at which an input current flows, called `u:i` by
    both; "each" stands for all of `parts`, the same place in equal parts of the model, as `each T[i]`: an
    effect sits at every one, with parameters that all share. `aliases` are other names for the same place;
    `parameters` what the place has of its own: names as an effect asks for them, `c` for a stiffness, and
    those of the model's parameters.
    `is_grounded`: the potential of its end a is constant, so that nothing drives a flow there, or that of b
    is, by a component of one connector. `limits_only`: of a signal, no law makes sense but one that cuts it.
    `carries_gas`: what flows from one end to the other may be a gas.
    """

    name: str
    kind: SiteKind
    domain: Domain
    connectors: tuple[str, ...] = ()
    aliases: tuple[str, ...] = ()
    parameters: tuple[tuple[str, str], ...] = ()
    is_grounded: bool = False
    limits_only: bool = False
    carries_gas: bool = False
    parts: tuple[Site, ...] = ()

    @property
    def told(self) -> str:
        """What it is, in words."""
        if self.parts:
            return f"{len(self.parts)} times {self.parts[0].told}"
        return f"{'an' if self.domain == 'electrical' else 'a'} {self.domain} {self.kind}"

    @property
    def given(self) -> dict[str, str]:
        """The model's parameters by the names that an effect asks for."""
        return dict(self.parameters)


@dataclass(frozen=True)
class Placement:
    """An effect at a site under the name of its component (empty: a free one), with the values of its
    parameters and, for its `Effect.inputs`, the names of the model's inputs that supply them (default
    NAME_INPUT, a new one), with the units that new ones have (default those of the effect); at a parameter,
    those of any variables of the model."""

    effect: Effect
    site: Site
    name: str = ""
    values: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    input_units: Mapping[str, str] = field(default_factory=dict)

    def unit_of(self, name: str, own: str) -> str:
        """Of a new input of the model for the effect's signal `name`, whose `own` unit it is where the other
        does not convert."""
        unit = self.input_units.get(name, "")
        return unit if own and is_of(unit, own) else own
