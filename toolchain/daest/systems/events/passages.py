"""A model with events followed from sample to sample: what a filter needs of it.

Between the samples of a recording a filter carries a state and its mode through the events in between. A
small change of the state passes an event with the saltation matrix (Leine & Nijmeijer 2004, section 7); so
does a covariance (Kong, Payne, Council & Johnson, "The Salted Kalman Filter", Automatica 2021).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daest.systems.events.event_update import HybridError, Mode, settled_start
from daest.systems.events.hybrid import Engine, Inputs, Runner

MOST_TURNS = 8  # corrections of one estimate until it lies on the side of every switch that its mode has
ON_THE_BORDER = 1e-12  # how far inside an estimate is put that was beyond a switch, in sizes of the switch
SINGULAR = 1e-6  # a switch whose variance is below this share of the square of its error is certain


@dataclass(frozen=True)
class Leg:
    """A smooth piece of a passage, from `start` to `end` [s], and the event at its end.

    states (2, n): at both ends, before the event; transition (n, n): ∂x(end)/∂x(start); jump (n, n): the
    saltation matrix of the event, None where the piece ends without one; theta (n_theta,): parameters with
    the mode on the way.
    """

    start: float
    end: float
    states: np.ndarray
    transition: np.ndarray
    jump: np.ndarray | None
    theta: np.ndarray


class Passages:
    """A model under the inputs of one recording. Every method takes a state (n,) with its mode, and changes
    the mode."""

    def __init__(
        self,
        engine: Engine,
        inputs: Inputs,
        rtol: float,
        atol: np.ndarray,
        max_steps: int,
        with_slopes: bool = True,
    ) -> None:
        n = engine.explicit.n_states
        self.runner = Runner(engine, inputs, rtol, atol, max_steps, n if with_slopes else 0)
        self.inputs, self.functions = inputs, self.runner.functions
        self.size = atol / np.max(atol)
        self.eye = np.eye(n) if with_slopes else np.zeros((n, 0))

    def start(self, theta: np.ndarray, x: np.ndarray | None) -> tuple[np.ndarray, Mode, list[Leg]]:
        """State, mode and events at the first instant; `x` None: the start of the model itself."""
        t = float(self.inputs.time[0])
        x, mode = settled_start(self.functions, theta, self.inputs.at(t, 0), t, x)
        self._enter(mode)
        self.runner.first_ticks(x, t)
        x, legs = self._run(0, t, t, x)
        return x, mode, legs

    def over(self, k: int, x: np.ndarray, mode: Mode) -> tuple[np.ndarray, list[Leg]]:
        """From sample k to sample k + 1, with the events at the latter."""
        self._enter(mode)
        time = self.inputs.time
        return self._run(k, float(time[k]), float(time[k + 1]), x)

    def agreed(self, k: int, x: np.ndarray, cov: np.ndarray, mode: Mode) -> tuple[np.ndarray, np.ndarray]:
        """The state at sample k on that side of every switch which the mode says, after a measurement has
        moved it; and ∂x/∂x before.

        A switch that the motion would pass anyway was passed a moment before: the event happens there. One
        that the motion comes back from keeps its side: the state is put on the border, along the directions
        of `cov` (n, n).
        """
        self._enter(mode)
        turn = np.eye(x.size)
        for _ in range(MOST_TURNS):
            beyond = self._beyond(k, x)
            if beyond is None:
                break
            left, g, along, speed, side = beyond
            stays = left & (side * speed >= 0) & np.any(along != 0, axis=1)
            if np.any(stays):
                x = _on_the_border(x, (cov, np.diag(self.size**2)), stays, g, along, side)
                continue
            found = self._late_event(k, x, *self._oldest(k, left, g, speed), mode.copy())
            if found is None:
                break
            x, turn = found[0], found[1] @ turn
        return x, turn

    # One passage --------------------------------------------------------------------------------------------

    def _enter(self, mode: Mode) -> None:
        self.runner.mode = mode
        self.runner.dense, self.runner.last_event = 0, -np.inf

    def _run(self, k: int, t: float, end: float, x: np.ndarray) -> tuple[np.ndarray, list[Leg]]:
        runner, legs = self.runner, []
        i = k
        while True:
            mode = runner.mode
            due = runner.schedule.next(x, self.inputs.at(t, self.inputs.interval(t)), mode, t)
            theta = mode.theta.copy()
            if due <= min(t, end) + runner.schedule.near(t):
                at = x
                x, S = runner.timed_event(x, self.eye, t, self.inputs.interval(t))
                legs.append(self._at_once(t, at, S, theta))
                continue
            at, counted = x, runner.n_events
            x, S = runner.input_event(x, self.eye, t)
            if runner.n_events > counted:
                legs.append(self._at_once(t, at, S, theta))
                continue
            if t >= end:
                return x, legs
            began, at = t, x
            i, t, x, S, left = runner.segment(i, t, min(due, end), x, self.eye)
            before = x
            jump = None
            if left is not None:
                x, after = runner.state_event(x, self.eye, t, left)
                jump = self._jump(after)
            legs.append(Leg(began, t, np.array([at, before]), self._transition(S), jump, theta))

    def _at_once(self, t: float, x: np.ndarray, S: np.ndarray, theta: np.ndarray) -> Leg:
        """An event without a way to it."""
        return Leg(t, t, np.array([x, x]), np.eye(x.size), self._jump(S), theta)

    def _transition(self, S: np.ndarray) -> np.ndarray:
        return S if S.shape[1] else np.eye(S.shape[0])

    def _jump(self, S: np.ndarray) -> np.ndarray | None:
        return S if S.shape[1] else None

    # Estimates that a measurement has moved beyond a switch -------------------------------------------------

    def _beyond(
        self, k: int, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """Of the root functions: which are beyond their side, values, slopes along the states, speeds, and
        sides; None where all keep their side."""
        side = self.runner.sides()
        if not side.size:
            return None
        t = float(self.inputs.time[k])
        interval = self.inputs.interval(t)
        ubar = self.inputs.at(t, interval)
        g, along, by_u, by_t = self.functions.root_slopes(self.runner.mode.instant(x, ubar, t))
        g = g.ravel()
        left = side * g < 0
        if not np.any(left):
            return None
        f = self.runner.rate(x, ubar, t)
        return left, g, along, along @ f + by_u @ self.inputs.rate(interval) + by_t.ravel(), side

    def _oldest(self, k: int, left: np.ndarray, g: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, float]:
        """Of the switches that were passed, those that were passed first, and how long ago [s]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ages = np.where(left & (speed != 0), g / speed, 0.0)
        longest = float(np.max(np.diff(self.inputs.time[max(k - 1, 0) : k + 2]), initial=0.0))
        ages = np.where(ages <= longest, ages, 0.0)
        age = float(np.max(ages))
        return left & (ages == age), age

    def _late_event(
        self, k: int, x: np.ndarray, passed: np.ndarray, age: float, before: Mode
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """The state after an event that it has passed already: back to the switch along the motion, through
        the event, and on. None, and the mode `before`, where the event finds no end."""
        t = float(self.inputs.time[k])
        interval = self.inputs.interval(t)
        ubar = self.inputs.at(t, interval)
        back = x - age * self.runner.rate(x, ubar, t)
        try:
            after, S = self.runner.state_event(back, self.eye, t, passed, interval)
        except HybridError:
            self.runner.mode.become(before)
            return None
        jump = self._jump(S)
        jump = np.eye(x.size) if jump is None else jump
        return after + age * self.runner.rate(after, ubar, t), jump


def _on_the_border(
    x: np.ndarray,
    covs: tuple[np.ndarray, ...],
    left: np.ndarray,
    g: np.ndarray,
    along: np.ndarray,
    side: np.ndarray,
) -> np.ndarray:
    """The likeliest state given that no switch of `left` is passed, by the first of the covariances that can
    move it there."""
    G = along[left]
    scale = np.abs(G) @ np.abs(x) + np.abs(g[left])
    wanted = side[left] * ON_THE_BORDER * scale - g[left]
    for cov in covs:
        S = G @ cov @ G.T
        if np.all(np.diagonal(S) > SINGULAR * wanted**2):
            return np.asarray(x + cov @ G.T @ (np.linalg.pinv(S) @ wanted))
    return x
