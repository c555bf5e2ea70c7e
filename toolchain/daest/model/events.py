"""Events: instants at which a model changes its mode, its discrete variables or its states.

Between events a model is a smooth DAE. What then keeps its value stands among its parameters (`Parameter`
with `is_memory`): Boolean and Integer variables that events assign, values before the event (`pre(x)`),
relations (`T > Tmax`), whole parts (`integer(x)`). A Real variable that events assign is a state with zero
derivative. Language Specification, Appendix B.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from daest.errors import Place


@dataclass(frozen=True)
class Relation:
    """A relation `value > 0` (`is_strict`) or `value >= 0` that holds its truth, parameter number `slot`,
    between events. `text` is the relation as it is written."""

    text: str
    slot: int
    is_strict: bool


@dataclass(frozen=True)
class WholePart:
    """The largest whole number below a value, which is parameter number `slot` between events."""

    text: str
    slot: int


@dataclass(frozen=True)
class Activation:
    """One branch of a when-clause. It becomes active at an event at which one of its conditions (rows `first`
    to `last` of `Events.conditions`) becomes true, unless one of the branches `before` it does."""

    first: int
    last: int
    before: tuple[int, ...]
    text: str
    place: Place | None = None


@dataclass(frozen=True)
class Assignment:
    """A variable that events assign: parameter number `slot`, or unknown number `unknown` where it is Real.
    The other one is -1."""

    name: str
    slot: int
    unknown: int

    @property
    def is_real(self) -> bool:
        """Whether it is an unknown, which keeps its value between events."""
        return self.unknown >= 0


@dataclass(frozen=True)
class Memory:
    """The value before the event, parameter number `slot`, of an expression (`Events.sources`)."""

    name: str
    slot: int


@dataclass(frozen=True)
class Restart:
    """`reinit`: unknown number `unknown` gets a value while branch number `activation` is active."""

    name: str
    unknown: int


@dataclass(frozen=True)
class Events:
    """What happens at events, as SX columns in the symbols of the `FlatModel` (ξ', ξ, u, w, θ, t), `active`
    (one per activation) and `ticks` (one per sample).

    `values` (relations), `wholes` (their arguments), `conditions`, `assigned` (values of `assignments`),
    `sources` (values of `memories`), `restarted` (two columns: whether, and the value), `samples` (two
    columns: start and interval [s]), `starts` (two columns per memory slot: whether the start of the model
    gives a value, and the value). `initial_slot` is the parameter that is 1 while the start is computed, -1
    if no equation asks.
    """

    relations: tuple[Relation, ...]
    whole_parts: tuple[WholePart, ...]
    activations: tuple[Activation, ...]
    assignments: tuple[Assignment, ...]
    memories: tuple[Memory, ...]
    restarts: tuple[Restart, ...]
    initial_slot: int
    start_slots: tuple[int, ...]
    active: ca.SX
    ticks: ca.SX
    values: ca.SX
    wholes: ca.SX
    conditions: ca.SX
    assigned: ca.SX
    sources: ca.SX
    restarted: ca.SX
    samples: ca.SX
    starts: ca.SX
