"""Bounded Fisher scoring with Levenberg-Marquardt damping, for likelihoods with exact gradients.

A step solves (I + λ diag I) dz = -g over the coordinates that are free; a coordinate rests at its bound
while the objective pulls it outwards. A step to a place where the objective cannot be evaluated is
shortened, not fatal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

FIRST_DAMPING = 1e-3
LARGEST_DAMPING = 1e12
LARGEST_STEP = 2.5  # per iteration and coordinate: a factor 12 for a logarithmic one
CONVERGED_GAIN = 1e-6  # predicted gain of the next step, in log-likelihood: 0.0014 standard errors
STALLED_GAIN = 1e-3  # above this predicted gain, a search that finds no better point has not converged
SLOW_STEPS = 5  # a search also ends where that many steps together gain less than SLOW_GAIN
SLOW_GAIN = 10.0  # times the gain of one step that ends it: a flat valley, or the noise of the integration
FLAT = 1e-14  # information of a coordinate, relative to the largest, below which it has no influence


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
    """A better point with the damping for the next step; `evaluation` has slopes if they were computed at
    once, `is_first` tells whether the first trial was better."""

    z: np.ndarray
    damping: float
    evaluation: Evaluation
    is_first: bool


def minimise(
    objective: Objective,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    max_iterations: int = 60,
    converged_gain: float = CONVERGED_GAIN,
) -> Found | None:
    """Search from `start` until a step would gain less than `converged_gain` in log-likelihood, or several
    steps have gained little more; None when the objective has no value there."""
    z = np.clip(start, lower, upper)
    here = objective(z, True)
    if here is None:
        return None
    damping, gain = FIRST_DAMPING, np.inf
    values = [here.value]
    last = z  # point that the slopes of `here` belong to: a search may pass through points that have none
    at_once = True  # slopes with the first trial of an iteration, as long as first trials are good
    for iteration in range(max_iterations):
        free = _free(z, here, lower, upper)
        gain = _predicted_gain(here, free)
        if gain < converged_gain:
            return Found(last, here, "converged", iteration, gain)
        is_slow = (
            len(values) > SLOW_STEPS and values[-1 - SLOW_STEPS] - values[-1] < SLOW_GAIN * converged_gain
        )
        step = None if is_slow else _improve(objective, z, here, free, damping, lower, upper, at_once)
        if step is None:
            is_near = gain < max(STALLED_GAIN, converged_gain)
            reason: Literal["converged", "stalled"] = "converged" if is_near else "stalled"
            return Found(last, here, reason, iteration, gain)
        z, damping, at_once = step.z, step.damping, step.is_first
        there = step.evaluation if step.evaluation.gradient.size else objective(z, True)
        if there is not None:
            last, here = z, there
        values.append(here.value)
    return Found(last, here, "iteration limit", max_iterations, gain)


def _improve(
    objective: Objective,
    z: np.ndarray,
    here: Evaluation,
    free: np.ndarray,
    damping: float,
    lower: np.ndarray,
    upper: np.ndarray,
    at_once: bool,
) -> _Step | None:
    """The next point; None when no damping gives a better one. `at_once` computes slopes with the first
    trial: they are wanted if it is better."""
    is_first = True
    while damping <= LARGEST_DAMPING:
        step = _damped_step(here, free, damping)
        trial = np.clip(z + step, lower, upper)
        moved = trial - z
        there = _evaluated(objective, trial, at_once and is_first) if np.any(moved) else None
        promised = -(here.gradient @ moved + moved @ here.information @ moved / 2)
        if there is not None and there.value < here.value:
            ratio = (here.value - there.value) / promised if promised > 0.0 else 0.0
            factor = 0.1 if ratio > 0.7 else 1.0 if ratio > 0.2 else 4.0
            return _Step(trial, damping * factor, there, is_first)
        is_first = False
        damping = max(damping, FIRST_DAMPING / 10) * 8.0
    return None


def _evaluated(objective: Objective, z: np.ndarray, with_slopes: bool) -> Evaluation | None:
    """With slopes only if they exist."""
    return (objective(z, True) if with_slopes else None) or objective(z, False)


def _free(z: np.ndarray, here: Evaluation, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Coordinates that move: off their bounds, or pulled inwards; and with any influence at all."""
    diagonal = np.diagonal(here.information)
    held = ((z <= lower) & (here.gradient >= 0.0)) | ((z >= upper) & (here.gradient <= 0.0))
    return ~held & (diagonal > FLAT * np.max(diagonal, initial=0.0))


def _damped_step(here: Evaluation, free: np.ndarray, damping: float) -> np.ndarray:
    step = np.zeros(free.size)
    if not np.any(free):
        return step
    information = here.information[np.ix_(free, free)]
    scale = np.sqrt(np.diagonal(information))
    system = information / np.outer(scale, scale)
    system = system + damping * np.eye(scale.size)
    step[free] = np.linalg.lstsq(system, -here.gradient[free] / scale, rcond=None)[0] / scale
    return step * min(1.0, LARGEST_STEP / max(np.max(np.abs(step)), LARGEST_STEP))


def _predicted_gain(here: Evaluation, free: np.ndarray) -> float:
    """gᵀ I⁻¹ g / 2 over the free coordinates."""
    if not np.any(free):
        return 0.0
    step = np.zeros(free.size)
    information = here.information[np.ix_(free, free)]
    scale = np.sqrt(np.diagonal(information))
    solved = np.linalg.lstsq(information / np.outer(scale, scale), here.gradient[free] / scale, rcond=FLAT)[0]
    step[free] = solved / scale
    return float(here.gradient @ step / 2)
