"""Simulation of a model with events, with sensitivities that jump with them.

Between events the model is smooth and is integrated as any other. An event is an instant at which a relation
changes its truth, a whole part its number, or a sample is due. Instants that follow from time alone are
computed; others are found by the integrator (`radau.c`), where a relation leaves its side of zero. At the
event all that depends on it is updated until nothing changes any more (Language Specification, Appendix B).

Sensitivities follow the event: with the instant t(p) at which g(x, p, t) = 0,

    dt/dp = -(g_x S + g_p) / (g_x f- + g_t),    S+ = d/dp [R(x-, p, t)] along the event - f+ dt/dp,

R being what the event does to the states (saltation; e.g. Leine & Nijmeijer 2004, section 7). Where a jump
of the held input makes a relation change, the recording gives the instant, and dt/dp = 0.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from typing import Protocol

import casadi as ca
import numpy as np

from daest.model.flat import ExplicitModel
from daest.numerics.compiler import pointer
from daest.systems.events.event_functions import EventFunctions
from daest.systems.events.event_update import EventUpdate, Forced, HybridError, Mode, Slopes, settled_start
from daest.systems.events.integration import FAILURES, IntegrationError

SAME_INSTANT = 1e-12  # events nearer to each other than this, relative to the time or the record's, are one
ROOT_NOISE = 1e-13  # as in radau.c: how far beyond zero a function has left its side, in its own unit
DENSE, MOST_DENSE = 1e-9, 2000  # events nearer to each other than this share of the record, and how many
MOST_EVENTS = 2_000_000


@dataclass(frozen=True)
class HybridRun:
    """As `integrate.Trajectory`; `theta` (n_samples, n_theta) holds what keeps its value between events.
    `tears` (n_samples, n_tears): from which the loops at each sample are solved.
    `n_events` counts events, `instants` holds the first of them [s] and what they were."""

    states: np.ndarray
    outputs: np.ndarray
    sensitivities: np.ndarray
    theta: np.ndarray
    tears: np.ndarray
    n_steps: int
    n_events: int
    instants: tuple[tuple[float, str], ...]


# Time -------------------------------------------------------------------------------------------------------


@dataclass
class Schedule:
    """The instants that follow from time alone."""

    functions: EventFunctions
    span: float = 1.0  # of the record [s]
    due: list[tuple[float, int, float]] = field(default_factory=list)

    def near(self, t: float) -> float:
        """How far from t an instant may be and be the same [s]."""
        return SAME_INSTANT * max(self.span, abs(t))

    def next(self, x: np.ndarray, ubar: np.ndarray, mode: Mode, t: float) -> float:
        """The next instant after t, infinite if there is none; `due` then tells what is due: the number of a
        relation or whole part with its new value, or that of a sample (negative). Shapes: x (n_states,), ubar
        (n_ū,); t [s]."""
        functions, events = self.functions, self.functions.events
        found: list[tuple[float, int, float]] = []
        n = len(events.relations)
        if np.any(functions.timed):
            zero, slope = functions.clock(mode.instant(x, ubar, t))
            for i in np.flatnonzero(functions.timed):
                if i < n:
                    truth = mode.theta[events.relations[i].slot]
                    if slope[i] != 0 and (slope[i] > 0) != (truth > 0.5):
                        due = max(float(-zero[i] / slope[i]), t)
                        found.append((due, int(i), float(slope[i] > 0)))
                elif slope[i] != 0:
                    number = mode.theta[events.whole_parts[i - n].slot]
                    edge = number + 1 if slope[i] > 0 else number
                    after = edge if slope[i] > 0 else number - 1
                    found.append((max(float((edge - zero[i]) / slope[i]), t), int(i), float(after)))
        for k, (start, interval) in enumerate(self.samples(x, ubar, mode, t)):
            found.append((float(start + mode.ticks_done[k] * interval), -1 - k, 1.0))
        if not found:
            return np.inf
        first = min(when for when, _, _ in found)
        self.due = [one for one in found if one[0] <= first + self.near(first)]
        return first

    def samples(self, x: np.ndarray, ubar: np.ndarray, mode: Mode, t: float) -> np.ndarray:
        """Start and interval [s] of every `sample(start, interval)` (n_ticks, 2) at x (n_states,), ubar
        (n_ū,) and the time t [s]."""
        events = self.functions.events
        if not events.ticks.numel():
            return np.zeros((0, 2))
        none = np.zeros(events.active.numel()), np.zeros(events.ticks.numel())
        return self.functions.at(mode.instant(x, ubar, t), *none).samples


# Integration ------------------------------------------------------------------------------------------------


class Engine(Protocol):
    """What an `Integrator` has that is used here."""

    @property
    def explicit(self) -> ExplicitModel: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def rhs(self) -> ca.Function: ...

    @property
    def out(self) -> ca.Function: ...

    @property
    def library(self) -> ctypes.CDLL | None: ...

    @property
    def events(self) -> tuple[EventFunctions, np.ndarray] | None:
        """What events do, and the owner of each root function (n_roots,); None for a model without events."""


@dataclass(frozen=True)
class Inputs:
    """Inputs along the record: values at both ends of each interval (n_samples - 1, n_ū), and at the end."""

    time: np.ndarray
    u0: np.ndarray
    u1: np.ndarray
    last: np.ndarray

    def near(self, t: float) -> float:
        """How far from t an instant may be and be the same [s]."""
        return SAME_INSTANT * max(float(self.time[-1] - self.time[0]) or 1.0, abs(t))

    def interval(self, t: float) -> int:
        """The interval that begins at or before t, where rounding may have put t a little before a sample; at
        the last sample `len(u0)`, in which the inputs are `last`."""
        at = int(np.searchsorted(self.time, t + self.near(t), side="right")) - 1
        return min(max(at, 0), len(self.u0))

    def interval_before(self, t: float) -> int:
        """The interval that ends at or behind t."""
        at = int(np.searchsorted(self.time, t - self.near(t), side="left")) - 1
        return min(max(at, 0), max(len(self.u0) - 1, 0))

    def jumps_at(self, t: float) -> bool:
        """Whether the inputs jump at t."""
        old, new = self.interval_before(t), self.interval(t)
        return new == old + 1 and not np.array_equal(self.u1[old], self.at(t, new))

    def at(self, t: float, interval: int) -> np.ndarray:
        if interval >= len(self.u0):
            return self.last.ravel()
        a, b = self.time[interval], self.time[interval + 1]
        share = (t - a) / (b - a)
        return self.u0[interval] + share * (self.u1[interval] - self.u0[interval])

    def along(self, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inputs (n_knots - 1, n_ū) at both ends of the pieces between the knots, each in the interval that
        it begins in: `interval` and `at` for all of them."""
        starts, n = knots[:-1], len(self.u0)
        near = SAME_INSTANT * np.maximum(float(self.time[-1] - self.time[0]) or 1.0, np.abs(starts))
        which = np.clip(np.searchsorted(self.time, starts + near, side="right") - 1, 0, n)
        if n == 0:
            ends = np.tile(self.last.ravel(), (starts.size, 1))
            return ends, ends.copy()
        inside, which = (which < n)[:, None], np.minimum(which, n - 1)
        a, length = self.time[which], self.time[which + 1] - self.time[which]
        first, change = self.u0[which], self.u1[which] - self.u0[which]
        shares = ((t - a) / length for t in (starts, knots[1:]))
        u0, u1 = (np.where(inside, first + share[:, None] * change, self.last.ravel()) for share in shares)
        return u0, u1

    def rate(self, interval: int) -> np.ndarray:
        if interval >= len(self.u0):
            return np.zeros(self.last.size)
        length = self.time[interval + 1] - self.time[interval]
        return (self.u1[interval] - self.u0[interval]) / length


def follow(
    model: Engine,
    inputs: Inputs,
    theta: np.ndarray,
    x0: np.ndarray,
    mode: Mode | None,
    *,
    directions: int,
    rtol: float,
    atol: np.ndarray,
    max_steps: int,
) -> HybridRun:
    """The trajectory at `inputs.time`. `mode` None: the start is settled at x0. Sensitivities have the
    directions of `Integrator`. Shapes: theta (n_theta,), x0 and atol (n_states,)."""
    runner = Runner(model, inputs, rtol, atol, max_steps, directions)
    return runner.run(theta, x0, mode)


class Runner:
    """One run: where it is, and what is written. `mode` is that of the instant it has reached."""

    mode: Mode

    def __init__(
        self,
        model: Engine,
        inputs: Inputs,
        rtol: float,
        atol: np.ndarray,
        max_steps: int,
        directions: int,
    ) -> None:
        if model.library is None or model.events is None:
            raise HybridError(
                "events-need-compiler",
                "a model with events is simulated by compiled code, and there is no C compiler here, or the "
                "model is too large for one",
                remedy="pip install 'daest[compiler]' brings a compiler.",
            )
        self.model, self.inputs, self.rtol, self.atol = model, inputs, rtol, atol
        self.functions, self.owners = model.events
        span = float(inputs.time[-1] - inputs.time[0]) or 1.0
        self.schedule = Schedule(self.functions, span)
        self.max_steps, self.directions = max_steps, directions
        n, n_states, n_y = inputs.time.size, model.explicit.n_states, model.out.numel_out(0)
        self.states, self.outputs = np.full((n, n_states), np.nan), np.full((n, n_y), np.nan)
        self.sens = np.empty((n, n_y, directions))
        self.theta = np.empty((n, len(model.explicit.flat.parameters)))
        self.tears = np.full((n, model.explicit.n_tears), np.nan)
        self.n_steps = self.n_events = self.dense = 0
        self.last_event = -np.inf
        self.instants: list[tuple[float, str]] = []

    def run(self, theta: np.ndarray, x0: np.ndarray, mode: Mode | None) -> HybridRun:
        """The whole record at the parameters theta (n_theta,) from the states x0 (n_states,), or on in a
        `mode`."""
        time = self.inputs.time
        t, i = float(time[0]), 0
        x = x0.copy()
        if mode is None:
            x, mode = settled_start(self.functions, theta, self.inputs.at(t, 0), t, x0)
        self.mode = mode
        self.first_ticks(x, t)
        n_states = x.size
        S = np.zeros((n_states, self.directions))
        if self.directions:
            S[:, self.directions - n_states :] = np.eye(n_states)
        while True:
            due = self.schedule.next(x, self.inputs.at(t, self.inputs.interval(t)), mode, t)
            if due <= t + self.schedule.near(t):
                x, S = self.timed_event(x, S, t, self.inputs.interval(t))
                continue
            stop = min(due, float(time[-1]))
            i, t, x, S, left = self.segment(i, t, stop, x, S)
            if left is not None:
                x, S = self.state_event(x, S, t, left)
                x, S = self.input_event(x, S, t)
            elif t >= due:
                x, S = self.timed_event(x, S, t, self.inputs.interval(t))
            else:
                x, S = self.input_event(x, S, t)
            if t >= time[-1]:
                self._write_last(i, t, x, S)
                break
        return HybridRun(
            self.states,
            self.outputs,
            self.sens,
            self.theta,
            self.tears,
            self.n_steps,
            self.n_events,
            tuple(self.instants),
        )

    def first_ticks(self, x: np.ndarray, t: float) -> None:
        """Samples before the record begins are past. Shapes: x (n_states,); t [s]."""
        for k, (start, interval) in enumerate(self.schedule.samples(x, self.inputs.at(t, 0), self.mode, t)):
            if not interval > 0:
                raise HybridError(
                    "events-sample-interval",
                    f"sample(start, interval) with the interval {interval:g} s",
                    remedy="Give a positive interval.",
                )
            passed = np.ceil((t - start) / interval - self.schedule.near(t) / interval)
            self.mode.ticks_done[k] = max(passed, 0.0)

    # One smooth piece ---------------------------------------------------------------------------------------

    def segment(
        self, i: int, t: float, stop: float, x: np.ndarray, S: np.ndarray
    ) -> tuple[int, float, np.ndarray, np.ndarray, np.ndarray | None]:
        """From t to `stop`, or to the first root before: the next sample, time, states, sensitivities, and
        which roots were met. Shapes: x (n_states,), S (n_states, d), roots (n_roots,); t and `stop` [s]."""
        time, inputs = self.inputs.time, self.inputs
        near = self.schedule.near(t)
        if stop <= t + near:
            return i, max(stop, t), x, S, None
        # A sample beside an event, as rounding puts it, is one at the event.
        first = int(np.searchsorted(time, t + near, side="right"))
        beyond = int(np.searchsorted(time, stop - near, side="left"))
        inner = time[first:beyond]
        inner = inner[np.diff(inner, prepend=-np.inf) > near]
        knots = np.concatenate([[t], inner, [stop]])
        piece = self._call(knots, *inputs.along(knots), x, S)
        # Row 0 is a sample where t is one; the stop itself belongs to what follows it, and so does a sample
        # at which a jump of the input is an event.
        for row in range(min(piece.done, knots.size - 1)):
            if piece.left is not None and knots[row] >= piece.t:
                break
            while i < time.size and time[i] <= knots[row] + near:
                self._write(i, piece, row)
                i += 1
        self.n_steps += piece.steps
        return i, piece.t, piece.x, piece.S, piece.left

    def _write(self, i: int, piece: _Piece, row: int) -> None:
        self.states[i], self.outputs[i], self.tears[i] = (
            piece.states[row],
            piece.outputs[row],
            piece.tears[row],
        )
        self.theta[i] = self.mode.theta
        if self.directions:
            self.sens[i] = piece.sens[row]

    def _write_last(self, i: int, t: float, x: np.ndarray, S: np.ndarray) -> None:
        if i >= self.inputs.time.size:
            return
        piece = self._call(np.array([t]), np.zeros((0, self.inputs.last.size)), np.zeros((0, 0)), x, S)
        for row in range(i, self.inputs.time.size):
            self._write(row, piece, 0)

    def _call(
        self, knots: np.ndarray, u0: np.ndarray, u1: np.ndarray, x: np.ndarray, S: np.ndarray
    ) -> _Piece:
        library = self.model.library
        if x.size == 0:
            return self._without_states(knots, u0, u1)
        assert library is not None
        n, n_y, d = knots.size, self.outputs.shape[1], self.directions
        states, outputs = np.empty((n, x.size)), np.empty((n, n_y))
        sens = np.empty((n, n_y, d))
        steps, done, reached = ctypes.c_long(0), ctypes.c_long(0), np.zeros(3)
        flags, x_end, S_end = np.zeros(max(self.owners.size, 1)), np.empty(x.size), np.empty((x.size, d))
        arrays = [
            np.ascontiguousarray(a, dtype=float)
            for a in (knots, u0, u1, self.inputs.last, self.mode.theta, x)
        ]
        start = np.ascontiguousarray(S)
        seen = np.full((n, self.tears.shape[1]), np.nan)
        tears = np.append(self.mode.tears, np.nan)
        common = (
            ctypes.c_long(n), *map(pointer, arrays), ctypes.c_int(d), pointer(start),
        )  # fmt: skip
        side = np.ascontiguousarray(np.append(self.sides(), 0.0))
        status = library.daest_follow(
            *common, ctypes.c_double(self.rtol), pointer(self.atol), ctypes.c_long(self.max_steps),
            *map(pointer, (side, states, outputs, sens)), ctypes.byref(steps), pointer(reached),
            pointer(flags), ctypes.byref(done), pointer(x_end), pointer(S_end), pointer(tears), pointer(seen),
        )  # fmt: skip
        if status not in (0, _EVENT):
            raise IntegrationError(FAILURES[status].format(steps=steps.value, next=reached[1]), reached[0])
        self.mode.tears = tears[:-1]
        left = flags[: self.owners.size] > 0.5 if status == _EVENT else None
        t = float(reached[0]) if status == _EVENT else float(knots[-1])
        return _Piece(states, outputs, sens, seen, steps.value, done.value, t, x_end, S_end, left)

    def _without_states(self, knots: np.ndarray, u0: np.ndarray, u1: np.ndarray) -> _Piece:
        """A model that has only time and inputs: roots are looked for at `SCANNED` instants of each interval,
        and bisected."""
        functions, mode, side = self.functions, self.mode, self.sides()
        empty = np.zeros(0)
        outputs = np.full((knots.size, self.outputs.shape[1]), np.nan)
        seen = np.full((knots.size, self.tears.shape[1]), np.nan)

        def inputs_at(i: int, t: float) -> np.ndarray:
            share = (t - knots[i]) / (knots[i + 1] - knots[i])
            return np.asarray(u0[i] + share * (u1[i] - u0[i]))

        def left_at(i: int, t: float) -> np.ndarray:
            return side * functions.root_values(mode.instant(empty, inputs_at(i, t), t)) < 0

        def piece(t: float, done: int, left: np.ndarray | None) -> _Piece:
            shape = (knots.size, outputs.shape[1], self.directions)
            states, sens = np.zeros((knots.size, 0)), np.zeros(shape)
            return _Piece(
                states, outputs, sens, seen, 0, done, t, empty, np.zeros((0, self.directions)), left
            )

        for i, knot in enumerate(knots):
            u = u0[i] if i < len(u0) else self.inputs.last.ravel()
            seen[i] = mode.tears
            outputs[i], mode.tears = self._seen(u, knot)
            if i + 1 == knots.size or not (side.size or seen.size):
                continue
            low = knot
            for high in np.linspace(knot, knots[i + 1], SCANNED + 1)[1:]:
                if not np.any(left_at(i, high)):
                    low = high
                    if seen.size:
                        _, mode.tears = self._seen(inputs_at(i, high), high)
                    continue
                while high - low > self.schedule.near(high):
                    middle = 0.5 * (low + high)
                    low, high = (low, middle) if np.any(left_at(i, middle)) else (middle, high)
                return piece(float(high), i + 1, left_at(i, high))
        return piece(float(knots[-1]), knots.size, None)

    def _seen(self, ubar: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Outputs and tears of a model without states."""
        try:
            return self.functions.outputs(self.mode.instant(np.zeros(0), ubar, t))
        except RuntimeError as error:
            raise IntegrationError(UNSOLVED, t) from error

    def sides(self) -> np.ndarray:
        """The sign that each root function keeps: what it tells is so, or is not yet. Shapes: (n_roots,)."""
        events, n = self.functions.events, len(self.functions.events.relations)
        found = np.empty(self.owners.size)
        for k, owner in enumerate(self.owners):
            if owner < n:
                found[k] = 1.0 if self.mode.theta[events.relations[owner].slot] > 0.5 else -1.0
            else:
                found[k] = -1.0
        return found

    # Events -------------------------------------------------------------------------------------------------

    def state_event(
        self, x: np.ndarray, S: np.ndarray, t: float, left: np.ndarray, interval: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """States and sensitivities after an event at which the root functions `left` leave their sides, under
        the inputs of `interval` (None: the one that ends there, unless the next one makes them leave).
        Shapes: x (n_states,), S (n_states, d), left (n_roots,)."""
        events, n = self.functions.events, len(self.functions.events.relations)
        by_input = interval is None and self.inputs.jumps_at(t) and not np.any(left & self._beyond(x, t))
        if interval is None:
            interval = self.inputs.interval(t) if by_input else self.inputs.interval_before(t)
        ubar = self.inputs.at(t, interval)
        none = np.zeros(events.active.numel()), np.zeros(events.ticks.numel())
        point = self.functions.at(self.mode.instant(x, ubar, t), *none)
        forced: dict[int, tuple[float, float]] = {}
        up: dict[int, bool] = {}
        for k in np.flatnonzero(left):
            owner = int(self.owners[k])
            up[owner] = bool(k + 1 < self.owners.size and self.owners[k + 1] == owner)
            if owner < n:
                new = 1.0 - self.mode.theta[events.relations[owner].slot]
                forced[owner] = (new, point.values[owner])
            else:
                number = self.mode.theta[events.whole_parts[owner - n].slot]
                forced[owner] = (number + 1 if up[owner] else number - 1, 0.0)
        first = min(forced)
        self._count(t, self._name(first))
        if by_input:  # the switches are clear of zero, so that nothing has to be held against rounding
            slopes = self._slopes_before(x, S, t, ubar, interval, None)
            return self._after(x, t, ubar, none[1], {}, slopes)
        slopes = self._slopes_before(x, S, t, ubar, interval, first)
        return self._after(x, t, ubar, none[1], forced, slopes)

    def input_event(self, x: np.ndarray, S: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        """States and sensitivities after what a jump of the inputs at t does to switches, if anything.
        Shapes: x (n_states,), S (n_states, d)."""
        if self.owners.size and self.inputs.jumps_at(t):
            left = self._beyond(x, t, self.inputs.interval(t))
            if np.any(left):
                return self.state_event(x, S, t, left)
        return x, S

    def _beyond(self, x: np.ndarray, t: float, interval: int | None = None) -> np.ndarray:
        """Which root functions have left their sides, under the inputs of `interval` (None: the one that ends
        at t)."""
        interval = self.inputs.interval_before(t) if interval is None else interval
        g = self.functions.root_values(self.mode.instant(x, self.inputs.at(t, interval), t))
        return np.asarray(self.sides() * g < -ROOT_NOISE)

    def timed_event(
        self, x: np.ndarray, S: np.ndarray, t: float, interval: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """States (n_states,) and sensitivities (n_states, d) after what is due at the time t [s]."""
        events = self.functions.events
        interval = self.inputs.interval_before(t) if t > self.inputs.time[0] else interval
        ubar = self.inputs.at(t, interval)
        ticks = np.zeros(events.ticks.numel())
        forced: dict[int, tuple[float, float]] = {}
        none = np.zeros(events.active.numel())
        point = self.functions.at(self.mode.instant(x, ubar, t), none, ticks)
        for _, number, value in self.schedule.due:
            if number < 0:
                ticks[-1 - number] = 1.0
                self.mode.ticks_done[-1 - number] += 1
            else:
                at = point.values[number] if number < len(events.relations) else 0.0
                forced[number] = (value, at)
        owner = self.schedule.due[0][1]
        self._count(t, self._name(owner))
        slopes = self._slopes_before(x, S, t, ubar, interval, owner)
        return self._after(x, t, self.inputs.at(t, self.inputs.interval(t)), ticks, forced, slopes)

    def _name(self, owner: int) -> str:
        events = self.functions.events
        if owner < 0:
            return "sample"
        n = len(events.relations)
        return events.relations[owner].text if owner < n else events.whole_parts[owner - n].text

    def _count(self, t: float, what: str) -> None:
        self.n_events += 1
        if len(self.instants) < MOST_SHOWN:
            self.instants.append((t, what))
        span = float(self.inputs.time[-1] - self.inputs.time[0])
        self.dense = self.dense + 1 if t - self.last_event < DENSE * span else 0
        self.last_event = t
        if self.dense > MOST_DENSE or self.n_events > MOST_EVENTS:
            raise HybridError(
                "events-chatter",
                f"at t = {t:g} s the switch `{what}` goes to and fro without end",
                remedy="Give it a hysteresis (on above one value, off below a smaller one), let the motion "
                "come to rest (a mode that holds it, as friction that sticks), or round the jump, as "
                "tanh(v/v_small) rounds sign(v).",
            )

    def _slopes_before(
        self, x: np.ndarray, S: np.ndarray, t: float, ubar: np.ndarray, interval: int, owner: int | None
    ) -> Slopes | None:
        """Sensitivities at the instant of the event, which moves with the parameters; `owner` None: at an
        instant of the recording, which does not."""
        if not self.directions:
            return None
        functions, n = self.functions, len(self.functions.events.relations)
        n_p = len(self.model.names)
        flat = self.model.explicit.flat
        theta = np.zeros((len(flat.parameters), self.directions))
        theta[flat.parameter_columns(self.model.names), np.arange(n_p)] = 1.0
        none = np.zeros(functions.events.active.numel()), np.zeros(functions.events.ticks.numel())
        rate = self.inputs.rate(interval)
        f = self.rate(x, ubar, t)
        slopes = Slopes(S, theta, np.zeros(self.directions), rate)
        if owner is None:
            return slopes

        def along(name: str) -> list[np.ndarray]:
            return functions.derivatives(name, self.mode.instant(x, ubar, t), *none)

        if owner >= 0:
            name, row = ("values", owner) if owner < n else ("wholes", owner - n)
            by_x, by_u, by_theta, by_t = (part[row] for part in along(name))
            moved = by_x @ S + by_theta @ theta
            speed = float(by_x @ f + by_u @ rate + by_t[0])
            slopes.time = -moved / speed if speed != 0 else slopes.time
        else:
            k = -1 - owner
            by_x, _, by_theta, _ = along("samples")
            count = self.mode.ticks_done[k] - 1
            change = by_x @ S + by_theta @ theta
            slopes.time = change[2 * k] + count * change[2 * k + 1]
        assert slopes.time.size == self.directions and n_p <= self.directions
        slopes.states = S + np.outer(f, slopes.time)
        return slopes

    def rate(self, x: np.ndarray, ubar: np.ndarray, t: float) -> np.ndarray:
        """ẋ (n_states,) in the mode of the instant."""
        return self.functions.rates(self.mode.instant(x, ubar, t))

    def _after(
        self,
        x: np.ndarray,
        t: float,
        ubar: np.ndarray,
        ticks: np.ndarray,
        forced: Forced,
        slopes: Slopes | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        x = EventUpdate(self.functions, x, self.mode, ubar, t, ticks, forced, slopes).settled()
        if slopes is None:
            return x, np.zeros((x.size, 0))
        return x, slopes.states - np.outer(self.rate(x, ubar, t), slopes.time)


@dataclass(frozen=True)
class _Piece:
    states: np.ndarray
    outputs: np.ndarray
    sens: np.ndarray
    tears: np.ndarray
    steps: int
    done: int
    t: float
    x: np.ndarray
    S: np.ndarray
    left: np.ndarray | None


UNSOLVED = "a nonlinear equation inside the model has no solution that was found from the one before"
_EVENT = 8  # the status of radau.c
MOST_SHOWN = 20  # events that a run names
SCANNED = 16  # instants of each sample interval at which a model without states is looked at for switches
