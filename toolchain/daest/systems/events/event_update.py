"""What a model does at one event: relations, discrete variables and restarted states that agree with each
other (Language Specification, Appendix B), and how sensitivities pass through it.

Relations are put right all at once as long as that leads anywhere, then one after the other, at last in
random order: elements that stick and slip, coupled with each other, have modes from which switching all
relations at once never comes to rest (M. Otter, H. Elmqvist and S. E. Mattsson 1999, mixed systems)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from daest.errors import ModelError, NumericalError
from daest.systems.events.event_functions import EventFunctions, EventPoint, Instant
from daest.systems.reduction.initialize import initial_point

MOST_ROUNDS = 400  # updates of all variables at one event
ALL_AT_ONCE = 20  # of them, those in which all relations change together
IN_TURN = 80  # then, until this round, one after the other; then one at random

Forced = Mapping[int, tuple[float, float]]
"""Relations and whole parts that the event itself changes: their new value, and the value of their function
at which it does. Rounding does not undo that."""


@dataclass
class Mode:
    """What keeps its value between events: θ with it, and the conditions of when-clauses at the last
    event; and the tears of the algebraic loops at the last instant (`ExplicitModel.near`), NaN or none where
    they are not known: which solution a loop with several is at."""

    theta: np.ndarray
    conditions: np.ndarray
    ticks_done: np.ndarray  # how often each sample has been taken
    tears: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def copy(self) -> Mode:
        """A mode that changes on its own."""
        return Mode(self.theta.copy(), self.conditions.copy(), self.ticks_done.copy(), self.tears.copy())

    def instant(self, x: np.ndarray, ubar: np.ndarray, t: float) -> Instant:
        """An instant in this mode. Shapes: x (n_states,), ubar (n_ū,); t [s]."""
        return Instant(x, ubar, self.theta, t, self.tears)

    def become(self, other: Mode) -> None:
        """Take over another mode."""
        self.theta, self.conditions, self.ticks_done = other.theta, other.conditions, other.ticks_done
        self.tears = other.tears

    def stored(self) -> np.ndarray:
        """All of it as numbers. Shapes: (n_theta + n_conditions + n_tears + n_ticks,)."""
        return np.concatenate([self.theta, self.conditions, self.tears, self.ticks_done])

    @classmethod
    def of_stored(cls, numbers: np.ndarray, n_theta: int, n_conditions: int, n_tears: int) -> Mode:
        """The mode of `stored`. Shapes: numbers (n_theta + n_conditions + n_tears + n_ticks,)."""
        sizes = np.cumsum([n_theta, n_conditions, n_tears])
        theta, conditions, tears, ticks = np.split(numbers, sizes)
        return cls(theta, conditions > 0.5, ticks, tears)


@dataclass
class Slopes:
    """Sensitivities of states (n_states, d) and of θ (n_theta, d) while an event is worked on; `time` (d,) is
    that of the event's instant, `input_rate` (n_ū,) how fast the inputs move there."""

    states: np.ndarray
    theta: np.ndarray
    time: np.ndarray
    input_rate: np.ndarray


class HybridError(NumericalError):
    """The simulation stopped at an event."""


def settled_start(
    functions: EventFunctions,
    theta: np.ndarray,
    ubar: np.ndarray,
    t: float,
    given: Mapping[str, float] | np.ndarray | None = None,
) -> tuple[np.ndarray, Mode]:
    """States (n_states,) and mode at the start: initial equations, start values of what is remembered, and
    when-clauses with `initial()`.

    `given`: start values by name, or all states. Raises what `initial_point` raises, and NumericalError
    `events-do-not-settle`."""
    events, explicit = functions.events, functions.explicit
    n_u = explicit.rhs.numel_in(1)
    fixed = isinstance(given, np.ndarray)
    mode = Mode(
        np.array(theta, dtype=float),
        np.zeros(events.conditions.numel(), dtype=bool),
        np.zeros(events.ticks.numel()),
        np.full(explicit.n_tears, np.nan),
    )
    if events.initial_slot >= 0:
        mode.theta[events.initial_slot] = 1.0
    x = np.array(given, dtype=float) if fixed else np.zeros(explicit.n_states)
    event = EventUpdate(functions, x, mode, ubar, t)
    order = Order()
    for _ in range(MOST_ROUNDS):
        if not fixed:
            event.x, _ = initial_point(explicit, mode.theta, ubar[:n_u], ubar[n_u:], t, given)  # type: ignore[arg-type]
        point = event.point(mode.theta)
        new = mode.theta.copy()
        new[list(events.start_slots)] = point.starts
        event.switch(new, point, order)
        if np.array_equal(new, mode.theta):
            break
        mode.theta = new
    else:
        raise unsettled(t, "the start")
    asleep = mode.theta.copy()
    if events.initial_slot >= 0:
        asleep[events.initial_slot] = 0.0
    mode.conditions = event.point(asleep).conditions > 0.5
    x = event.settled()
    if events.initial_slot >= 0:
        mode.theta[events.initial_slot] = 0.0
        x = EventUpdate(functions, x, mode, ubar, t).settled()
    return x, mode


@dataclass
class Order:
    """In which order the relations that are not what they should be change."""

    rounds: int = 0
    last: int = -1  # the relation that changed last
    random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def chosen(self, wrong: list[int]) -> list[int]:
        """Of the relations `wrong`, those that change in this round."""
        self.rounds += 1
        if self.rounds <= ALL_AT_ONCE or not wrong:
            return wrong
        if self.rounds <= IN_TURN:
            self.last = next((one for one in wrong if one > self.last), wrong[0])
        else:
            self.last = int(self.random.choice(wrong))
        return [self.last]


@dataclass
class EventUpdate:
    """An event at time `t`, with inputs `ubar` and the samples that are due there (`ticks`). It changes `x`
    (n_states,), `mode` and `slopes` (None: no sensitivities are wanted)."""

    functions: EventFunctions
    x: np.ndarray
    mode: Mode
    ubar: np.ndarray
    t: float
    ticks: np.ndarray | None = None
    forced: Forced = field(default_factory=dict)
    slopes: Slopes | None = None

    def __post_init__(self) -> None:
        events = self.functions.events
        self.ticks = np.zeros(events.ticks.numel()) if self.ticks is None else self.ticks
        self.active = np.zeros(events.active.numel())  # branches of when-clauses

    def point(self, theta: np.ndarray) -> EventPoint:
        """Everything at the instant, as it is now."""
        assert self.ticks is not None
        instant = Instant(self.x, self.ubar, theta, self.t, self.mode.tears)
        return self.functions.at(instant, self.active, self.ticks)

    def settled(self) -> np.ndarray:
        """The states after the event. Raises HybridError where it goes on for ever."""
        events, mode = self.functions.events, self.mode
        memory = [one.slot for one in events.memories]
        ticks, self.ticks = self.ticks, np.zeros(events.ticks.numel())
        mode.theta[memory] = self.point(mode.theta).sources
        self._follow_memory(memory)
        self.ticks = ticks
        for _ in range(MOST_ROUNDS):
            point = self._consistent()
            conditions = point.conditions > 0.5
            again = not np.array_equal(mode.theta[memory], point.sources)
            again |= not np.array_equal(mode.conditions, conditions)
            x_new = self._restarted(point)
            again |= x_new is not None
            mode.theta[memory] = point.sources
            self._follow_memory(memory)
            mode.conditions = conditions
            self.x = self.x if x_new is None else x_new
            self.ticks = np.zeros(events.ticks.numel())
            if events.initial_slot >= 0:
                again |= mode.theta[events.initial_slot] != 0
                mode.theta[events.initial_slot] = 0.0
            if not again:
                return self.x
            self.active = np.zeros(events.active.numel())
        raise unsettled(self.t, "an event")

    # Relations and what is assigned -------------------------------------------------------------------------

    def switch(self, theta: np.ndarray, point: EventPoint, order: Order) -> None:
        """Relations and whole parts put into θ as they are at the point, those whose turn it is."""
        events = self.functions.events
        truths = [self._truth(i, point.values[i]) for i in range(len(events.relations))]
        wrong = [i for i, one in enumerate(events.relations) if theta[one.slot] != truths[i]]
        for i in order.chosen(wrong):
            theta[events.relations[i].slot] = truths[i]
        n = len(events.relations)
        for i, part in enumerate(events.whole_parts):
            number = np.floor(point.wholes[i])
            if n + i in self.forced and abs(point.wholes[i] - self.forced[n + i][0]) <= 0.5:
                number = self.forced[n + i][0]
            theta[part.slot] = number

    def _truth(self, number: int, value: float) -> float:
        if number in self.forced and abs(value) <= 2 * abs(self.forced[number][1]) + np.finfo(float).tiny:
            return self.forced[number][0]
        return float(value > 0 if self.functions.events.relations[number].is_strict else value >= 0)

    def _rising(self, conditions: np.ndarray) -> np.ndarray:
        """Which branches of when-clauses become active."""
        rising = (conditions > 0.5) & ~self.mode.conditions
        found = np.zeros(len(self.functions.events.activations))
        for i, branch in enumerate(self.functions.events.activations):
            is_next = not any(found[j] for j in branch.before)
            found[i] = float(is_next and bool(np.any(rising[branch.first : branch.last])))
        return found

    def _consistent(self) -> EventPoint:
        """Relations, active branches and assigned variables that agree with each other, given the values
        before the event."""
        events, mode, order = self.functions.events, self.mode, Order()
        for _ in range(MOST_ROUNDS):
            point = self.point(mode.theta)
            theta = mode.theta.copy()
            self.switch(theta, point, order)
            now = self._rising(point.conditions)
            for one, value in zip(events.assignments, point.assigned, strict=True):
                if one.slot >= 0:
                    theta[one.slot] = value
            held = [
                (one.unknown, value)
                for one, value in zip(events.assignments, point.assigned, strict=True)
                if one.is_real
            ]
            moved = self._with_variables(held)
            is_settled = np.array_equal(theta, mode.theta, equal_nan=True)
            if is_settled and np.array_equal(now, self.active) and np.array_equal(moved, self.x):
                self._follow_assigned()
                return point
            self.x, self.active, mode.theta = moved, now, theta
        raise unsettled(self.t, "an event")

    # States -------------------------------------------------------------------------------------------------

    def _with_variables(self, wanted: list[tuple[int, float]]) -> np.ndarray:
        """States at which the unknowns `wanted` have their values, each being a state or the same as one."""
        if not wanted:
            return self.x
        made = self.x.copy()
        present, _ = self._variables()
        for unknown, value in wanted:
            state, share = self.state_behind(unknown)
            if present[unknown] != value:
                moved = self.x[state] + (value - present[unknown]) / share
                made[state] = moved if abs(share) != 1 else share * value
        return made

    def _variables(self) -> tuple[np.ndarray, np.ndarray]:
        """ξ and ∂ξ/∂x as they are now."""
        return self.functions.variables(self.mode.instant(self.x, self.ubar, self.t))

    def state_behind(self, unknown: int) -> tuple[int, float]:
        """The state that decides an unknown, and its share in it."""
        explicit = self.functions.explicit
        variable = explicit.flat.unknowns[unknown]
        if variable.name in explicit.state_names:
            return explicit.state_names.index(variable.name), 1.0
        row = self._variables()[1][unknown]
        (states,) = np.nonzero(row)
        if states.size != 1:
            raise ModelError(
                "event-state",
                f"an event gives `{variable.name}` a value, but it is no state of its own: "
                f"{', '.join(explicit.state_names[i] for i in states) or 'no state'} decide it",
                where=variable.place,
                remedy="Restart the variable that is differentiated, or mark it with stateSelect = "
                "StateSelect.always.",
            )
        return int(states[0]), float(row[states[0]])

    def _restarted(self, point: EventPoint) -> np.ndarray | None:
        """States after `reinit`; None where nothing restarts."""
        restarts = self.functions.events.restarts
        due = [i for i in range(len(restarts)) if point.restarted[i, 0] > 0.5]
        if not due:
            return None
        wanted = [(restarts[i].unknown, point.restarted[i, 1]) for i in due]
        if self.slopes is not None:
            along = self._along("restarted", self.slopes)
            for i in due:
                state, share = self.state_behind(restarts[i].unknown)
                self.slopes.states[state] = along[i] / share
        return self._with_variables(wanted)

    # Sensitivities ------------------------------------------------------------------------------------------

    def _along(self, name: str, slopes: Slopes) -> np.ndarray:
        """Total derivatives (rows, d) of what `Events` calls `name`, at the instant of the event."""
        assert self.ticks is not None
        instant = self.mode.instant(self.x, self.ubar, self.t)
        by_x, by_u, by_theta, by_t = self.functions.derivatives(name, instant, self.active, self.ticks)
        rates = by_t[:, 0] + by_u @ slopes.input_rate
        return by_x @ slopes.states + by_theta @ slopes.theta + np.outer(rates, slopes.time)

    def _follow_memory(self, slots: list[int]) -> None:
        if self.slopes is not None:
            self.slopes.theta[slots] = self._along("sources", self.slopes)

    def _follow_assigned(self) -> None:
        """Real variables that the event assigns; one may follow from another."""
        assignments = self.functions.events.assignments
        rows = [i for i, one in enumerate(assignments) if one.is_real]
        if self.slopes is None or not rows:
            return
        behind = [self.state_behind(assignments[i].unknown) for i in rows]
        for _ in rows:
            along = self._along("assigned", self.slopes)
            for i, (state, share) in zip(rows, behind, strict=True):
                self.slopes.states[state] = along[i] / share


def unsettled(t: float, what: str) -> NumericalError:
    """The error of an event at time t that does not end."""
    return HybridError(
        "events-do-not-settle",
        f"the switches of the model find no common state at t = {t:g} s: {what} goes on for ever",
        remedy="Look for two switches that undo each other at the same instant; give one of them a "
        "hysteresis, or use pre() of it.",
    )
