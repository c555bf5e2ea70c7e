"""Profile likelihood: how far one parameter can move while everything else follows.

For every value of the parameter the objective is minimised over all other unknowns (initial states too),
each time from where the last value ended. The interval holds the values whose log-likelihood (with priors)
lies less than χ²(1) / 2 below the best. Noise that the objective estimates is estimated anew at every value.
Where residuals of a simulation are coloured, χ² is multiplied by the factor by which the colour widens the
variance of the estimate (Chandler and Bate, Biometrika 94, 2007).

Whether estimate ± 1.96 standard errors is an interval that the likelihood agrees with.

A standard error stands for a parabola: at the ends of its 95 % interval the log-likelihood, maximised over
everything else, is 1.92 below the best. With few data it may be anything. One evaluation at every end, where
the others follow by the information, tells; an end that looks wrong is looked at again with the others
searched for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from daest.errors import EstimationError
from daest.estimation.fitting.coordinates import Unknowns
from daest.estimation.fitting.search import Found, Objective, minimise
from daest.estimation.gates import FIT
from daest.model.fit import FitResult, FittedParameter, Profile, ProfileEnd
from daest.numerics.statistics import chi2

ALL = "all"  # in place of a name: every estimated parameter
STEPS_TO_END = 3.0  # steps that a parabola would need to the end of the interval
MOST_GROWTH = 3.0  # of a step from one value to the next, and of its shrinking
FIRST_STEP = 0.1  # in z, where the data give none
MOST_POINTS = 25  # on each side
MOST_HALVINGS = 6  # of a step to where the objective has no value
MOST_REFINEMENTS = 8
LOG_RANGE = np.log(1e3)  # an interval that is wider than this on one side counts as open
LARGEST_MOVE = 1.0  # in z, of another unknown along the tangent
ITERATIONS = 30

Tell = Callable[[str], None]


def silent(_text: str) -> None:
    """A progress callback that does nothing."""


@dataclass(frozen=True)
class Searched:
    """A search that ended: objective, unknowns (the first coordinates of z), bounds of z, and the end."""

    objective: Objective
    unknowns: Unknowns
    lower: np.ndarray
    upper: np.ndarray
    found: Found


def check_profile_names(names: Sequence[str], unknowns: Unknowns) -> None:
    """Error `profile-not-estimated`."""
    estimated = unknowns.parameter_names()
    for name in names:
        if name not in (*estimated, ALL):
            raise EstimationError(
                "profile-not-estimated",
                f"{name} has no profile, since it is not estimated",
                where=name,
                remedy=f"estimated are {', '.join(estimated)}; {ALL} means each of them",
            )


def with_profiles(result: FitResult, search: Searched, names: Sequence[str], tell: Tell) -> FitResult:
    """The result with the profiles of the named parameters."""
    estimated = search.unknowns.parameter_names()
    chosen = [name for name in estimated if name in names or ALL in names]
    profiles, notes = [], []
    for number, name in enumerate(chosen, start=1):
        tell(f"profile of {name} ({number} of {len(chosen)})")
        profile = _profile(result, search, estimated.index(name))
        profiles.append(profile)
        if np.min(profile.drops) < -2.0 * FIT.better_optimum:
            best = profile.values[np.argmin(profile.drops)]
            notes.append(f"a better optimum lies near {name} = {best:.6g}: start there, or use --starts")
    return replace(result, profiles=tuple(profiles), notes=(*result.notes, *notes))


def _profile(result: FitResult, search: Searched, index: int) -> Profile:
    coordinate = search.unknowns.coordinates[index]
    factor = colour_factor(result, search, index)
    threshold = float(chi2.ppf(FIT.interval_level, 1)) * factor
    sides = [_Side(search, index, direction, threshold).walked() for direction in (-1.0, 1.0)]
    centre = (search.found.z[index], 0.0)
    points = sorted([*sides[0].points, centre, *sides[1].points])
    values = np.array([coordinate.natural(z) for z, _ in points])
    ends = [None if side.crossing is None else coordinate.natural(side.crossing) for side in sides]
    return Profile(
        name=coordinate.name,
        values=values,
        drops=np.array([drop for _, drop in points]),
        threshold=threshold,
        level=FIT.interval_level,
        lower=ends[0],
        upper=ends[1],
        lower_end=sides[0].end,
        upper_end=sides[1].end,
    )


def colour_factor(result: FitResult, search: Searched, index: int) -> float:
    """Variance of the estimate over the inverse information, above 1 for coloured residuals alone."""
    std_error = next(
        p.std_error for p in result.parameters if p.name == search.unknowns.coordinates[index].name
    )
    step = _standard_step(search, index)
    if result.method != "oe" or std_error is None or step is None:
        return 1.0
    slope = search.unknowns.slopes(search.found.z[: len(search.unknowns.coordinates)])[index]
    return max(1.0, float((std_error / slope / step) ** 2))


def _standard_step(search: Searched, index: int) -> float | None:
    """Square root of the inverse information in z; None where there is none."""
    information = search.found.evaluation.information
    scale = np.sqrt(np.diagonal(information))
    active = scale > 0.0
    if not active[index]:
        return None
    scaled = information[np.ix_(active, active)] / np.outer(scale[active], scale[active])
    place = int(np.sum(active[:index]))
    variance = np.linalg.pinv(scaled, hermitian=True)[place, place]
    return float(np.sqrt(max(variance, 0.0)) / scale[index]) or None


class _Side:
    """Steps from the estimate in one direction until the drop reaches the threshold."""

    def __init__(self, search: Searched, index: int, direction: float, threshold: float) -> None:
        self.search, self.index, self.direction, self.threshold = search, index, direction, threshold
        self.points: list[tuple[float, float]] = []
        self.crossing: float | None = None
        self.end: ProfileEnd = "open"

    def walked(self) -> _Side:
        root = np.sqrt(self.threshold)
        here, at, size = self.search.found, 0.0, self._first_step(root)
        for _ in range(MOST_POINTS):
            there, size = self._next(here, size)
            if there is None:
                self.end = "failed"
                return self
            reached = self._root_drop(there)
            if reached >= root:
                self.crossing, self.end = self._refined(here, there), "found"
                return self
            if self._at_bound(there.z[self.index]):
                self.crossing, self.end = float(there.z[self.index]), "bound"
                return self
            if abs(there.z[self.index] - self.search.found.z[self.index]) >= self._range():
                return self
            slope = max(reached - at, 0.0) / abs(there.z[self.index] - here.z[self.index])
            wanted = root / STEPS_TO_END / slope if slope > 0.0 else np.inf
            size = float(np.clip(wanted, size / MOST_GROWTH, size * MOST_GROWTH))
            here, at = there, reached
        return self

    def _first_step(self, root: float) -> float:
        standard = _standard_step(self.search, self.index) or FIRST_STEP
        return min(standard * root / STEPS_TO_END, self._range() / STEPS_TO_END)

    def _range(self) -> float:
        return LOG_RANGE if self.search.unknowns.coordinates[self.index].is_log else FIT.open_interval

    def _at_bound(self, z: float) -> bool:
        bound = self.search.lower if self.direction < 0 else self.search.upper
        return bool(self.direction * (z - bound[self.index]) >= 0.0)

    def _next(self, here: Found, size: float) -> tuple[Found | None, float]:
        """The minimum one step on, with shorter steps where the objective has no value."""
        for _ in range(MOST_HALVINGS):
            there = self._minimum(here, here.z[self.index] + self.direction * size)
            if there is not None:
                self.points.append((float(there.z[self.index]), self._drop(there)))
                return there, size
            size /= 2.0
        return None, size

    def _minimum(self, here: Found, value: float) -> Found | None:
        return held_minimum(self.search, here, self.index, value)

    def _drop(self, there: Found) -> float:
        return float(2.0 * (there.evaluation.value - self.search.found.evaluation.value))

    def _root_drop(self, there: Found) -> float:
        return float(np.sqrt(max(self._drop(there), 0.0)))

    def _refined(self, inside: Found, outside: Found) -> float:
        """The crossing of the threshold; the root of the drop is nearly straight. False position, with the
        Illinois weight, between two ends that are re-optimised."""
        root = np.sqrt(self.threshold)
        a, fa = inside.z[self.index], self._root_drop(inside) - root
        b, fb = outside.z[self.index], self._root_drop(outside) - root
        for _ in range(MOST_REFINEMENTS):
            z = a - fa * (b - a) / (fb - fa)
            there = self._minimum(inside, z)
            if there is None:
                break
            self.points.append((float(z), self._drop(there)))
            f = self._root_drop(there) - root
            if abs(self._drop(there) - self.threshold) < FIT.interval_accuracy * self.threshold:
                break
            if f * fb < 0.0:
                a, fa = b, fb
            else:
                fa /= 2.0
            b, fb = z, f
        return float(z)


def held_minimum(search: Searched, here: Found, index: int, value: float) -> Found | None:
    """The minimum with a coordinate held at `value`, searched from where its tangent at `here` leads."""
    value = float(np.clip(value, search.lower[index], search.upper[index]))
    move = tangent(here.evaluation.information, index) * (value - here.z[index])
    # Along what the data hardly tell, a tangent may lead anywhere.
    move[np.abs(move) > LARGEST_MOVE] = 0.0
    lower, upper = search.lower.copy(), search.upper.copy()
    lower[index] = upper[index] = value
    starts = [np.clip(start, lower, upper) for start in (here.z + move, here.z)]
    valued = [(there.value, n) for n, z in enumerate(starts) if (there := search.objective(z, False))]
    if not valued:
        return None
    start = starts[min(valued)[1]]
    return minimise(search.objective, start, lower, upper, ITERATIONS, FIT.profile_gain)


def tangent(information: np.ndarray, index: int) -> np.ndarray:
    """dz / dz_i along which the others stay optimal to first order. Shapes: information (n_z, n_z); the
    direction (n_z,)."""
    others = np.flatnonzero((np.arange(len(information)) != index) & (np.diagonal(information) > 0.0))
    scale = np.sqrt(np.diagonal(information)[others])
    part = information[np.ix_(others, others)] / np.outer(scale, scale)
    direction = np.zeros(len(information))
    direction[others] = -np.linalg.lstsq(part, information[others, index] / scale, rcond=1e-10)[0] / scale
    direction[index] = 1.0
    return direction


TWO_SIDED = float(ndtri(0.975))  # standard errors to the end of a 95 % interval


NOT_QUADRATIC = "the likelihood is not quadratic in"


def with_interval_check(result: FitResult, search: Searched) -> FitResult:
    """The result with a note that names the parameters whose standard error makes no interval."""
    doubtful = doubtful_intervals(result, search)
    if not doubtful:
        return result
    listed, profiles = ", ".join(doubtful), " ".join(f"--profile {name}" for name in doubtful)
    note = (
        f"{NOT_QUADRATIC} {listed}: do not trust an interval of standard errors, "
        f"use the profile likelihood ({profiles})"
    )
    return replace(result, notes=(*result.notes, note))


def doubtful_intervals(result: FitResult, search: Searched) -> tuple[str, ...]:
    """Names of the parameters with a standard error whose 95 % interval the likelihood does not agree
    with."""
    names = search.unknowns.parameter_names()
    return tuple(
        p.name
        for p in result.parameters
        if p.std_error is not None
        and not p.at_bound
        and not _is_parabolic(result, search, names.index(p.name), p)
    )


def _is_parabolic(result: FitResult, search: Searched, index: int, parameter: FittedParameter) -> bool:
    coordinate, centre = search.unknowns.coordinates[index], search.found.z[index]
    factor = np.sqrt(colour_factor(result, search, index))
    for sign in (-1.0, 1.0):
        end = parameter.value + sign * TWO_SIDED * (parameter.std_error or 0.0)
        if not coordinate.lower < end < coordinate.upper:
            return False
        z = coordinate.searched(end)
        move = tangent(search.found.evaluation.information, index) * (z - centre)
        there = search.objective(np.clip(search.found.z + move, search.lower, search.upper), False)
        if there is not None and _is_expected(there.value - search.found.evaluation.value, factor):
            continue
        # The others may follow along a curve.
        followed = held_minimum(search, search.found, index, z)
        if followed is None or not _is_expected(
            followed.evaluation.value - search.found.evaluation.value, factor
        ):
            return False
    return True


def _is_expected(drop: float, factor: float) -> bool:
    """Whether a drop of the log-likelihood is what a parabola has at the end of its interval."""
    return abs(np.sqrt(2.0 * max(drop, 0.0)) / (TWO_SIDED * factor) - 1.0) <= FIT.parabolic_end
