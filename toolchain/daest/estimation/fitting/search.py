"""Bounded Fisher scoring within a trust region, for likelihoods with exact gradients.

A step solves (I + λ diag I) dz = -g over the coordinates that are free, with the damping λ that makes it as
long as the region is wide (Moré 1978); a coordinate rests at its bound while the objective pulls it
outwards. A step to a place where the objective cannot be evaluated is shortened, not fatal.

A search that creeps along a curved valley, where the quadratic model holds only for short steps, leaps now
and then: the last steps are extended to a parabola, and few steps from its end lead back to the floor.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from daest.estimation.gates import FIT
from daest.numerics import deadline
from daest.numerics.bordered import bordered

FIRST_DAMPING = 1e-3
HALVINGS = 30  # of the logarithm of the damping that gives a step its length
SLOW_STEPS = 5  # a search also ends where that many steps together gain less than FIT.slow_gain
CREEPING_STEPS = 3  # in a row, after which the search leaps
FIRST_LEAP, LONGEST_LEAP = 4.0, 256.0  # steps
RETURN_STEPS = 2  # from there to the floor of the valley
MANY = 60  # coordinates, from which on factors cost less than eigenvalues
NEWTON_STEPS, SAME_LENGTH = 10, 1.1  # of the damping that gives a step its length


@dataclass(frozen=True)
class Evaluation:
    """Negative log-likelihood at a point; `gradient` (p,) and `information` (p, p), empty unless asked."""

    value: float
    gradient: np.ndarray = field(default_factory=lambda: np.zeros(0))
    information: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


Objective = Callable[[np.ndarray, bool], Evaluation | None]


@dataclass(frozen=True)
class Found:
    """End of a search. `reason` "converged": the next step would gain too little to matter."""

    z: np.ndarray
    evaluation: Evaluation
    reason: Literal["converged", "stalled", "iteration limit"]
    iterations: int
    predicted_gain: float


@dataclass(frozen=True)
class _Step:
    """A better point with the radius for the next step; `evaluation` has slopes if they were computed at
    once, `is_first` tells whether the first trial was better."""

    z: np.ndarray
    radius: float
    evaluation: Evaluation
    is_first: bool


def minimise(
    objective: Objective,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    max_iterations: int = 60,
    converged_gain: float = FIT.converged_gain,
    goal: float = np.inf,
) -> Found | None:
    """Search from `start` until a step would gain less than `converged_gain` in log-likelihood, several
    steps have gained little more, or the objective will not fall to the `goal`, to judge by what the next
    step promises and what the last ones have gained; None when the objective has no value there. Raises
    OutOfTimeError. Shapes: start, lower and upper (n_z,)."""
    z = np.clip(start, lower, upper)
    here = objective(z, True)
    if here is None:
        return None
    gain, radius = np.inf, None
    course = _Course()
    values = [here.value]
    last = z  # point that the slopes of `here` belong to: a search may pass through points that have none
    at_once = True  # slopes with the first trial of an iteration, as long as first trials are good
    for iteration in range(max_iterations):
        deadline.check()
        steps = _steps(here, free_coordinates(z, here, lower, upper))
        gain = steps.gain
        if gain < converged_gain:
            return Found(last, here, "converged", iteration, gain)
        lately = values[-1 - SLOW_STEPS] - values[-1] if len(values) > SLOW_STEPS else np.inf
        foreseen = min(gain, lately / SLOW_STEPS)
        if here.value - FIT.goal_reach * (max_iterations - iteration) * foreseen > goal:
            return Found(last, here, "stalled", iteration, gain)
        is_slow = lately < FIT.slow_gain * converged_gain
        step = None if is_slow else _improve(objective, z, here, steps, radius, lower, upper, at_once)
        if step is None:
            is_near = gain < max(FIT.stalled_gain, converged_gain)
            reason: Literal["converged", "stalled"] = "converged" if is_near else "stalled"
            return Found(last, here, reason, iteration, gain)
        there = step.evaluation if step.evaluation.gradient.size else objective(step.z, True)
        if there is not None:
            course = course.followed(z, step.z, here.value - there.value < FIT.creeping_gain * gain)
            last, here = step.z, there
        z, radius, at_once = step.z, step.radius, step.is_first
        if course.is_straight:
            leap = _leaped(objective, here, radius, lower, upper, course)
            course = course.after_leap(leap is not None)
            z, here = leap or (z, here)
            last = z if leap else last
        values.append(here.value)
    return Found(last, here, "iteration limit", max_iterations, gain)


@dataclass(frozen=True)
class _Course:
    """The last points of a search that creeps, oldest first, and how many steps it leaps next."""

    points: tuple[np.ndarray, ...] = ()
    leap: float = FIRST_LEAP

    def followed(self, z: np.ndarray, following: np.ndarray, is_slow: bool) -> _Course:
        """After a step from z to `following`."""
        return _Course((*(self.points or (z,)), following), self.leap) if is_slow else _Course()

    @property
    def is_straight(self) -> bool:
        """Whether the last steps tell where the next ones lead."""
        return len(self.points) > CREEPING_STEPS

    def after_leap(self, was_better: bool) -> _Course:
        """The points before a leap tell nothing of the course any more."""
        return _Course(
            (), min(2.0 * self.leap, LONGEST_LEAP) if was_better else max(self.leap / 4.0, FIRST_LEAP)
        )


def _leaped(
    objective: Objective,
    here: Evaluation,
    radius: float,
    lower: np.ndarray,
    upper: np.ndarray,
    course: _Course,
) -> tuple[np.ndarray, Evaluation] | None:
    """A better point far along the parabola through the last points, a few steps back to the floor of the
    valley; None where there is none."""
    before, between, now = course.points[-3:]
    step, bend = now - between, now - 2.0 * between + before
    move = _limited(course.leap * step + course.leap * (course.leap + 1.0) / 2.0 * bend)
    z = np.clip(now + move, lower, upper)
    there = objective(z, True)
    for _ in range(RETURN_STEPS):
        if there is None or there.value < here.value:
            break
        free = free_coordinates(z, there, lower, upper)  # far away, others may rest or do nothing
        z = np.clip(z + _steps(there, free).within(radius)[0], lower, upper)
        there = objective(z, True)
    return (z, there) if there is not None and there.value < here.value else None


def _improve(
    objective: Objective,
    z: np.ndarray,
    here: Evaluation,
    steps: _Steps,
    radius: float | None,
    lower: np.ndarray,
    upper: np.ndarray,
    at_once: bool,
) -> _Step | None:
    """The next point; None when no radius gives a better one. `at_once` computes slopes with the first
    trial: they are wanted if it is better."""
    length = steps.length_at(FIRST_DAMPING) if radius is None else radius
    shortest, is_first = FIT.shortest_step * steps.length_at(0.0), True
    while length > shortest:
        step, length = steps.within(length)
        trial = np.clip(z + step, lower, upper)
        moved = trial - z
        there = _evaluated(objective, trial, at_once and is_first) if np.any(moved) else None
        promised = -(here.gradient @ moved + moved @ here.information @ moved / 2)
        if there is not None and there.value < here.value:
            ratio = (here.value - there.value) / promised if promised > 0.0 else 0.0
            return _Step(
                trial, length * (4.0 if ratio > 0.7 else 1.0 if ratio > 0.2 else 0.25), there, is_first
            )
        is_first = False
        length /= 4.0
    return None


class _Steps(ABC):
    """Steps from a point, by their length in units in which every coordinate alone has unit information.
    `gain` is what the undamped one promises."""

    gain: float

    def __init__(self, here: Evaluation, free: np.ndarray, scale: np.ndarray) -> None:
        self.free, self.scale, self.pull = free, scale, -here.gradient[free] / scale

    @abstractmethod
    def damped(self, damping: float) -> np.ndarray:
        """The step with that damping (n_free,)."""

    @abstractmethod
    def damping_of(self, length: float) -> float:
        """What makes a step that is longer about as long as that."""

    def length_at(self, damping: float) -> float:
        step = self.damped(damping)
        return math.sqrt(step @ step)  # as np.linalg.norm, in a third of its time: asked for at every halving

    def within(self, length: float) -> tuple[np.ndarray, float]:
        """The step of no more than that length, and its length."""
        damping = self.damping_of(length) if self.length_at(0.0) > length else 0.0
        step = np.zeros(self.free.size)
        step[self.free] = self.in_coordinates(self.damped(damping)) / self.scale
        step = _limited(step)
        return step, float(np.linalg.norm(step[self.free] * self.scale))

    def in_coordinates(self, step: np.ndarray) -> np.ndarray:
        """The step along the coordinates, where it is made along other directions."""
        return step


class _SpectralSteps(_Steps):
    """By the eigenvalues of the information: every damping costs next to nothing."""

    def __init__(
        self, here: Evaluation, free: np.ndarray, scale: np.ndarray, information: np.ndarray
    ) -> None:
        super().__init__(here, free, scale)
        values, self.vectors = np.linalg.eigh(information)
        self.pull = self.vectors.T @ self.pull
        size = np.abs(values)  # where the curvature is negative, the step goes downhill all the same
        flat = FIT.flat * np.max(size, initial=0.0)
        told = size > flat
        self.gain = float(np.sum(self.pull[told] ** 2 / size[told]) / 2)
        self.values = np.maximum(size, flat)

    def damped(self, damping: float) -> np.ndarray:
        return self.pull / (self.values + damping)

    def damping_of(self, length: float) -> float:
        low, high = (
            np.log(FIT.flat),
            np.log(max(float(np.linalg.norm(self.pull)) / length, 2.0 * FIT.flat)),
        )
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if self.length_at(np.exp(middle)) > length else (low, middle)
        return float(np.exp(high))

    def in_coordinates(self, step: np.ndarray) -> np.ndarray:
        return self.vectors @ step


class _FactoredSteps(_Steps):
    """By a factor for every damping: of hundreds of coordinates, a fraction of the work for eigenvalues.
    Raises LinAlgError where the information is not positive semi-definite."""

    def __init__(
        self, here: Evaluation, free: np.ndarray, scale: np.ndarray, information: np.ndarray
    ) -> None:
        super().__init__(here, free, scale)
        self.information = bordered(information)
        self.floor = FIT.flat
        while True:
            try:
                undamped = self.information.factor(self.floor)
                break
            except np.linalg.LinAlgError:
                self.floor *= 10.0
                if self.floor > FIT.flat_direction * scale.size:
                    raise
        self.solvers = {0.0: undamped}
        self.gain = float(self.pull @ self.damped(0.0) / 2)

    def damped(self, damping: float) -> np.ndarray:
        if damping not in self.solvers:
            self.solvers[damping] = self.information.factor(damping + self.floor)
        return self.solvers[damping](self.pull)

    def damping_of(self, length: float) -> float:
        """Newton's method for the reciprocal of the length (Moré 1978, section 5)."""
        damping = 0.0
        for _ in range(NEWTON_STEPS):
            step = self.damped(damping)
            square = float(step @ step)
            size = math.sqrt(square)
            if size <= length * SAME_LENGTH:
                break
            damping += square / float(step @ self.solvers[damping](step)) * (size - length) / length
        return damping


def _steps(here: Evaluation, free: np.ndarray) -> _Steps:
    scale, information = _scaled(here, free)
    if scale.size > MANY:
        with suppress(np.linalg.LinAlgError):
            return _FactoredSteps(here, free, scale, information)
    return _SpectralSteps(here, free, scale, information)


def whole_step(here: Evaluation, free: np.ndarray) -> tuple[np.ndarray, float]:
    """The undamped step (n_z,) over the coordinates that are `free` (n_z,), however long, and what it
    promises to gain."""
    scale, information = _scaled(here, free)
    pull = -here.gradient[free] / scale
    own = np.linalg.pinv(information, FIT.flat_direction, hermitian=True) @ pull
    step = np.zeros(free.size)
    step[free] = own / scale
    return step, float(pull @ own / 2)


def _scaled(here: Evaluation, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The square roots of the diagonal of the information over the free coordinates, and that information in
    units in which they are 1."""
    information = here.information[np.ix_(free, free)]
    scale = np.sqrt(np.abs(np.diagonal(information)))
    return scale, information / np.outer(scale, scale)


def _limited(step: np.ndarray) -> np.ndarray:
    """The step, shortened so that no coordinate moves by more than FIT.largest_step."""
    return step * min(1.0, FIT.largest_step / max(np.max(np.abs(step), initial=0.0), FIT.largest_step))


def _evaluated(objective: Objective, z: np.ndarray, with_slopes: bool) -> Evaluation | None:
    """With slopes only if they exist."""
    return (objective(z, True) if with_slopes else None) or objective(z, False)


def free_coordinates(z: np.ndarray, here: Evaluation, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Coordinates (n_z,) that move: off their bounds, or pulled inwards; and with any influence at all.
    Shapes: z, lower and upper (n_z,)."""
    diagonal = np.diagonal(here.information)
    held = ((z <= lower) & (here.gradient >= 0.0)) | ((z >= upper) & (here.gradient <= 0.0))
    return ~held & (diagonal > FIT.flat * np.max(diagonal, initial=0.0))
