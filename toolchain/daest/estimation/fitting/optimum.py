"""The best point that cheap starts lead to, and the doubts that an end must stand before it counts as
converged.

A search by slopes ends in the first valley. Five things lead out of a wrong one. Another start leads to
another valley, and where none is known, points all over the range of the parameters are scanned for one. A
logarithmic parameter that has run off by orders of magnitude has no slope left to come back by: it is put
back where the user started, the others are given time to follow while it is held there, and the search goes
on. One that does nothing at the end is moved to where it acts. And along a direction that the data hardly
tell the likelihood is no parabola: points to both sides are tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from daest.estimation.fitting.coordinates import Coordinate, Unknowns, lost_ones
from daest.estimation.fitting.search import Evaluation, Found, Objective, minimise
from daest.estimation.gates import FIT
from daest.numerics.statistics import whiteness_p_value

ROUNDS = 4  # of doubts and searches in a row
NOISE_DECADES = 13  # above its lower bound, in which a noise is looked for
WAKING = 6  # times that a value that does nothing is doubled or halved, until it acts
HELD_ITERATIONS = 8  # while a parameter that was put back is held
PROBES = (-3.0, -1.0, 1.0, 3.0)  # standard deviations
LONGEST_PROBE = 2.5  # in z, the same as the largest step of a search
MOST_PROBED = 6  # unknowns, the weakest
REVIVING = (1.0, 0.3, 0.1, 0.03)  # shares of the step that gives a lost parameter its size again
HILL, HILL_STDS = np.log(2.0), 3.0  # how far a parameter is moved to look over a hill: in z, in stds
NEAR_ITERATIONS = 5  # of a search, after which it is asked whether it leads to where another one ended
SCANNED = 64  # points over the range of the parameters (a power of two), of which the most likely are pursued
PURSUED, PURSUED_ITERATIONS = 8, 6
PROMISING = 2  # of these are searched to their end
NEAR_BOUNDS = 4.0  # spreads between them, within which all of their range is scanned


@dataclass(frozen=True)
class Search:
    """What is searched: `objective` over z, whose first coordinates are `unknowns`, within `lower` and
    `upper`. The user's start is `home`. A search ends where it will not come down to the `goal`."""

    objective: Objective
    unknowns: Unknowns
    lower: np.ndarray
    upper: np.ndarray
    home: np.ndarray
    max_iterations: int
    converged_gain: float = FIT.converged_gain
    hills: int = MOST_PROBED  # parameters that are moved over the hills beside the best end
    trusts_parabola: bool = False  # no hill is looked for where the likelihood is as its parabola has it
    goal: float = np.inf  # of the objective

    def minimum(self, z: np.ndarray, iterations: int | None = None, goal: float = np.inf) -> Found | None:
        """The end of a search from z (n_z,); None where the objective has no value there."""
        count = self.max_iterations if iterations is None else iterations
        goal = min(goal, self.goal)
        return minimise(self.objective, z, self.lower, self.upper, count, self.converged_gain, goal)

    def better(self, found: Found, z: np.ndarray) -> np.ndarray | None:
        """The end (n_z,) of a search from z if it is better than `found` by what is worth it; None if it is
        not, or will not be."""
        goal = found.evaluation.value - FIT.worthwhile_gain
        end = self.minimum(z, goal=goal)
        return end.z if end is not None and end.evaluation.value < goal else None


def best_point(
    search: Search,
    starts: Sequence[np.ndarray],
    is_doubtful: Callable[[Found], bool] = lambda _: False,
    further: Iterable[np.ndarray] = (),
) -> Found | None:
    """The best end of the searches from `starts`; None where the objective has a value at none of them.

    The most likely start goes first, and the others are left out unless its end `is_doubtful`; then come the
    `further` ones, each asked for only when its turn comes. `reason` is "stalled" where a better point lies
    beside the end after the last round. All points have the shape (n_z,).
    """
    best: Found | None = None
    for z in chain(_by_value(search, starts), further):
        found = _settled(search, z) if best is None else _rival(search, best, z)
        if found is not None and (best is None or rank(found) < rank(best)):
            best = found
        if best is not None and not (lost(search, best) or is_doubtful(best)):
            break
    if best is None or not search.hills or best.evaluation.value > search.goal:
        return best
    return _beyond_hills(search, best)


def scanned(search: Search, around: np.ndarray, seed: int) -> Iterator[np.ndarray]:
    """Where searches from the most likely of many points have come to after a few iterations, the best first.

    The points fill the range of the parameters (Sobol): between bounds that are near, else around the user's
    start; the other unknowns are those of `around`. Nothing is computed before the first one is asked for.
    Shapes: around and the points (n_z,).
    """
    from scipy.stats import qmc  # half a second, which few fits need

    unknowns = search.unknowns
    is_near = unknowns.upper - unknowns.lower < NEAR_BOUNDS * unknowns.spread
    low, high = unknowns.range_around(search.home[: unknowns.start.size], is_near)
    own = np.array([i for i, c in enumerate(unknowns.coordinates) if c.kind == "parameter"], dtype=int)
    points = np.tile(around, (SCANNED, 1))
    points[:, own] = (low + (high - low) * qmc.Sobol(low.size, seed=seed).random(SCANNED))[:, own]
    ends = [
        end
        for z in _by_value(search, list(points))[:PURSUED]
        if (end := search.minimum(z, PURSUED_ITERATIONS)) is not None
    ]
    ends.sort(key=lambda end: end.evaluation.value)
    yield from (end.z for end in ends[:PROMISING])


def _beyond_hills(search: Search, best: Found) -> Found:
    """The end of the searches from beyond the hills beside `best`, while they lead to better ones."""
    while best.iterations < search.max_iterations:
        z = _over_the_hill(search, best)
        found = None if z is None else _settled(search, z)
        if found is None or found.evaluation.value >= best.evaluation.value:
            break
        best = replace(found, iterations=best.iterations + found.iterations)
    return best


def _over_the_hill(search: Search, found: Found) -> np.ndarray | None:
    """A more likely point beyond a hill, or None.

    Time constants that trade places make valleys that look alike. Parameters are moved both ways, those that
    the data know least first, and first where the likelihood is another one than its parabola foretells. A
    parameter is held there while the others follow; if it is pulled on from there, not back, the search goes
    on.
    """
    directions = profile_directions(search, found)
    own = [(d, std) for d, std in directions if _unknown(search, d).kind == "parameter"]
    own = sorted(own, key=lambda pair: -pair[1])[: search.hills]
    moves = [(d, std, side * _size(std)) for d, std in own for side in (-1.0, 1.0)]
    foretold = [_is_foretold(search, found, direction, std, move) for direction, std, move in moves]
    order = [i for i, known in enumerate(foretold) if not known]
    if not search.trusts_parabola:
        order += [i for i, known in enumerate(foretold) if known]
    for i in order:
        direction, _, move = moves[i]
        there = _followed(search, found, direction, move)
        near = there and _elsewhere(search, found, there.z)
        freed = None if near is None else search.better(found, near.z)
        if freed is not None:
            return freed
    return None


def _size(std: float) -> float:
    return float(min(max(HILL, HILL_STDS * std), LONGEST_PROBE))


def _is_foretold(search: Search, found: Found, direction: np.ndarray, std: float, move: float) -> bool:
    """Whether the objective rises along the direction about as much as the parabola at the end has it."""
    there = search.objective(_moved(search, found, direction, move), False)
    rise = (move / std) ** 2 / 2 if std > 0.0 else np.inf
    if there is None:
        return True
    return bool(rise / FIT.foretold < there.value - found.evaluation.value < rise * FIT.foretold)


def _moved(search: Search, found: Found, direction: np.ndarray, move: float) -> np.ndarray:
    return np.clip(found.z + move * direction, search.lower, search.upper)


def _followed(search: Search, found: Found, direction: np.ndarray, move: float) -> Found | None:
    """Where the others follow the unknown of `direction`, held moved; None where that is no better and pulled
    back against `move`."""
    z = _moved(search, found, direction, move)
    i = int(np.argmax(direction == 1.0))
    lower, upper = search.lower.copy(), search.upper.copy()
    lower[i] = upper[i] = z[i]
    there = minimise(search.objective, z, lower, upper, NEAR_ITERATIONS, FIT.worthwhile_gain)
    if there is None:
        return None
    is_better = there.evaluation.value < found.evaluation.value - FIT.worthwhile_gain
    return there if is_better or move * there.evaluation.gradient[i] < 0.0 else None


def _unknown(search: Search, direction: np.ndarray) -> Coordinate:
    """That moves by 1."""
    return search.unknowns.coordinates[int(np.argmax(direction == 1.0))]


def coloured(
    residuals: Sequence[np.ndarray], observed: Sequence[np.ndarray], level: float = FIT.suspicious_level
) -> bool:
    """Whether residuals (n_samples, n_y) of any record are not white: the end of the search that left them
    is doubtful."""
    p_values = [
        whiteness_p_value(part[:, j], seen[:, j])
        for part, seen in zip(residuals, observed, strict=True)
        for j in range(part.shape[1])
    ]
    return min(p_values) * len(p_values) <= level


def rank(found: Found) -> float:
    """The value, with an end that converged before one as good as it that did not."""
    return found.evaluation.value - (FIT.stalled_gain if found.reason == "converged" else 0.0)


def lost(search: Search, found: Found) -> list[int]:
    """Parameters that have run off by orders of magnitude."""
    return lost_ones(search.unknowns, found.z, search.home)


def _by_value(search: Search, starts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Starts with a value, the most likely one first, each once. One alone is not asked for its value."""
    if len(starts) == 1:
        return [np.clip(starts[0], search.lower, search.upper)]
    valued: list[tuple[float, np.ndarray]] = []
    for start in starts:
        z = np.clip(start, search.lower, search.upper)
        here = search.objective(z, False)
        if here is not None and not any(np.array_equal(z, other) for _, other in valued):
            valued.append((here.value, z))
    return [z for _, z in sorted(valued, key=lambda pair: pair[0])]


def _rival(search: Search, best: Found, z: np.ndarray) -> Found | None:
    """The end of a search from z, unless it leads to where `best` is."""
    near = _elsewhere(search, best, z)
    if near is None:
        return None
    rest = _settled(search, near.z)
    return rest and replace(rest, iterations=rest.iterations + near.iterations)


def _elsewhere(search: Search, best: Found, z: np.ndarray) -> Found | None:
    """Where a few iterations from z lead, unless to where `best` is."""
    near = search.minimum(z, NEAR_ITERATIONS)
    return None if near is None or _is_in_valley(near, best) else near


def _is_in_valley(found: Found, best: Found) -> bool:
    """Whether the parabola about `best` foretells how much worse the other point is."""
    gap = found.z - best.z
    foretold = float(gap @ best.evaluation.information @ gap) / 2
    worse = found.evaluation.value - best.evaluation.value
    return worse >= 0.0 and abs(foretold - worse) <= FIT.same_valley * worse + FIT.worthwhile_gain


def _settled(search: Search, z: np.ndarray) -> Found | None:
    """The end of a search that went on while any doubt led to a better point."""
    found = search.minimum(z)
    if found is None:
        return None
    iterations = found.iterations
    # A search at its limit is not doubted: it would not be taken up again. One that will not come to its goal
    # is of no use.
    is_useful = iterations < search.max_iterations and found.evaluation.value <= search.goal
    better = _better(search, found) if is_useful else None
    for _ in range(ROUNDS):
        if better is None or iterations >= search.max_iterations:
            break
        again = search.minimum(better, search.max_iterations - iterations)
        if again is None:  # a value without slopes
            break
        iterations += again.iterations
        found, better = again, _better(search, again)
    if found.reason == "converged" and better is not None:
        found = replace(found, reason="stalled")
    return replace(found, iterations=iterations)


def _better(search: Search, found: Found) -> np.ndarray | None:
    """A point that is more likely than the end of a search, or None."""
    for doubt in (better_noise, _beside, _revived, _put_back, _awakened):
        z = doubt(search, found)
        if z is not None:
            return z
    return None


def better_noise(search: Search, found: Found) -> np.ndarray | None:
    """A point that differs in one noise and is more likely, or None.

    On a logarithmic scale the likelihood is flat towards zero noise, so that a search can come to rest there
    although more noise would be better. Noises with hardly any information are tried decade by decade. The
    point has the shape (n_z,).
    """
    trials = []
    for i, coordinate in enumerate(search.unknowns.coordinates):
        if coordinate.kind == "parameter" or found.evaluation.information[i, i] > FIT.settled_information:
            continue
        for decade in range(NOISE_DECADES + 1):
            trial = found.z.copy()
            trial[i] = min(search.lower[i] + decade * np.log(10.0), search.upper[i])
            trials.append(trial)
    return _best_of(search, trials, found.evaluation)


def _beside(search: Search, found: Found) -> np.ndarray | None:
    """A more likely point to the side of an unknown that the data hardly tell, or None."""
    return _best_of(search, weak_points(search, found), found.evaluation)


def weak_points(search: Search, found: Found) -> list[np.ndarray]:
    """Points to both sides of the unknowns that the data hardly tell, the others following as a parabola
    has it; no further than one step of a search. The points have the shape (n_z,)."""
    directions = profile_directions(search, found)
    weak = sorted(directions, key=lambda pair: -pair[1])[:MOST_PROBED]
    points = []
    for direction, std in weak:
        if std >= FIT.weak_std:
            longest = LONGEST_PROBE / float(np.max(np.abs(direction)))
            moves = {float(np.clip(share * std, -longest, longest)) for share in PROBES}
            points += [np.clip(found.z + m * direction, search.lower, search.upper) for m in sorted(moves)]
    return points


def profile_directions(search: Search, found: Found) -> list[tuple[np.ndarray, float]]:
    """For every unknown off its bounds and with influence: the direction in which it moves by 1 while the
    others follow, by the information, and its standard deviation in z. A direction has the shape (n_z,)."""
    inside = (found.z > search.lower) & (found.z < search.upper)
    diagonal = np.diagonal(found.evaluation.information)
    free = np.flatnonzero(inside & (diagonal > 0.0))
    scale = np.sqrt(diagonal[free])
    scaled = found.evaluation.information[np.ix_(free, free)] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    cov = (vectors / np.maximum(values, FIT.no_information)) @ vectors.T / np.outer(scale, scale)
    result = []
    for place, i in enumerate(free):
        if i < len(search.unknowns.coordinates):
            direction = np.zeros(found.z.size)
            direction[free] = cov[:, place] / cov[place, place]
            result.append((direction, float(np.sqrt(cov[place, place]))))
    return result


def _revived(search: Search, found: Found) -> np.ndarray | None:
    """A more likely point where parameters that went towards zero are as large as the slopes ask for, or
    None.

    On a logarithmic scale they have no slope left, in their own unit they have: one step of Fisher scoring
    there, with parameters left alone that it would make negative.
    """
    away = [i for i in lost(search, found) if found.z[i] < search.home[i]]
    scale = np.ones(found.z.size)
    scale[away] = np.exp(found.z[away])
    while away:
        step = _natural_step(search, found, scale, away)
        below = [i for i in away if step[i] <= 0.0]
        if not below:
            return _best_of(search, _shares_of(search, found, step, away), found.evaluation)
        away = [i for i in away if i not in below]
    return None


def _natural_step(search: Search, found: Found, scale: np.ndarray, away: list[int]) -> np.ndarray:
    """The step of Fisher scoring per unit of z over `scale`; parameters lost besides those `away` rest."""
    free = (found.z > search.lower) & (found.z < search.upper)
    free[[i for i in lost(search, found) if i not in away]] = False
    diagonal = np.diagonal(found.evaluation.information) / scale**2
    free &= diagonal > 0.0
    rows = np.flatnonzero(free)
    unit = scale[rows] * np.sqrt(diagonal[rows])
    values, vectors = np.linalg.eigh(found.evaluation.information[np.ix_(rows, rows)] / np.outer(unit, unit))
    pull = vectors.T @ (-found.evaluation.gradient[rows] / unit)
    step = np.zeros(found.z.size)
    step[rows] = vectors @ (pull / np.maximum(values, FIT.no_information)) / np.sqrt(diagonal[rows])
    return step


def _shares_of(search: Search, found: Found, step: np.ndarray, away: list[int]) -> list[np.ndarray]:
    points = []
    for share in REVIVING:
        z = found.z + np.clip(share * step, -LONGEST_PROBE, LONGEST_PROBE)
        z[away] = np.log(np.exp(found.z[away]) + share * step[away])
        points.append(np.clip(z, search.lower, search.upper))
    return points


def _put_back(search: Search, found: Found) -> np.ndarray | None:
    """A more likely point that a search reaches from where lost parameters are put back, or None.

    All together, then each alone: one may be zero in truth.
    """
    away = lost(search, found)
    groups = [away] if len(away) == 1 else [away, *([i] for i in away)] if away else []
    for group in groups:
        held = found.z.copy()
        held[group] = search.home[group]
        freed = _freed(search, found, held, group)
        if freed is not None:
            return freed
    return None


def _freed(search: Search, found: Found, z: np.ndarray, group: list[int]) -> np.ndarray | None:
    """A more likely point that a search reaches from z (n_z,) after the others have followed the unknowns of
    a `group`, held there; or None."""
    lower, upper = search.lower.copy(), search.upper.copy()
    lower[group] = upper[group] = z[group]
    followed = minimise(search.objective, z, lower, upper, HELD_ITERATIONS)
    return None if followed is None else search.better(found, followed.z)


def _awakened(search: Search, found: Found) -> np.ndarray | None:
    """A more likely point that a search reaches from where a parameter acts that does nothing at the end, or
    None: the rim of a tank has gone above all levels, and no slope leads back. Not asked of a search that
    another one follows."""
    if not search.hills:
        return None
    for i, coordinate in enumerate(search.unknowns.coordinates):
        inside = search.lower[i] < found.z[i] < search.upper[i]
        if coordinate.kind != "parameter" or not inside or _acts(found.evaluation, i):
            continue
        for side in (-1.0, 1.0):
            z = _acting(search, found, i, side)
            freed = None if z is None else _freed(search, found, z, [i])
            if freed is not None:
                return freed
    return None


def _acts(here: Evaluation, i: int) -> bool:
    """Whether an unknown has any influence on a step."""
    diagonal = np.diagonal(here.information)
    return bool(diagonal[i] > FIT.flat * np.max(diagonal, initial=0.0))


def _acting(search: Search, found: Found, i: int, side: float) -> np.ndarray | None:
    """The nearest of the points with an unknown doubled (`side` 1) or halved (-1) again and again at which it
    acts (n_z,); None where it acts at none."""
    is_log = search.unknowns.coordinates[i].is_log
    z = found.z.copy()
    for _ in range(WAKING):
        z[i] = z[i] + side * np.log(2.0) if is_log else z[i] * 2.0**side
        z = np.clip(z, search.lower, search.upper)
        here = search.objective(z, True)
        if here is not None and _acts(here, i):
            return z
    return None


def _best_of(search: Search, trials: Sequence[np.ndarray], here: Evaluation) -> np.ndarray | None:
    """The most likely of some points if it is more likely than `here`."""
    best, better = here.value - FIT.worthwhile_gain, None
    for z in trials:
        found = search.objective(z, False)
        if found is not None and found.value < best:
            best, better = found.value, z
    return better
