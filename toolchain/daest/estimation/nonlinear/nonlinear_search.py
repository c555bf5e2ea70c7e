"""The search of a nonlinear model: by simulation, by the predictions of an observer, by multiple shooting.

All end at the best of several starts (`optimum`). A simulation that starts far from the truth leaves the
record, and its errors have valleys without number; a predictor that every sample pulls back to the record
has few. Where the end of a simulation is doubtful, one with an assumed noise on every state is searched
first, and leads the simulation.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import count

import numpy as np

from daest.estimation.fitting.coordinates import objective as objective_of
from daest.estimation.fitting.optimum import Search, best_point, coloured, lost, rank, scanned
from daest.estimation.fitting.profile import Tell
from daest.estimation.fitting.records import RUN_LENGTHS, part_of
from daest.estimation.fitting.search import Found
from daest.estimation.fitting.setup import Setup, no_start
from daest.estimation.gates import FIT
from daest.estimation.linear.hold_search import are_steps, ranked_holds
from daest.estimation.nonlinear.gain_family import Levels
from daest.estimation.nonlinear.noise_levels import (
    Ending,
    assumed,
    at_size_of_innovations,
    average_along,
    gained,
    with_gain,
)
from daest.estimation.nonlinear.nonlinear_start import (
    asked_holds,
    called_back,
    further_starts,
    limits,
    scaled,
)
from daest.estimation.nonlinear.observer import observer
from daest.estimation.nonlinear.shooting import Cut, default_segments, search_by_shooting, start_of
from daest.estimation.nonlinear.trajectories import TrajectoryProblem, prediction_errors
from daest.model.fit import IdentifyOptions
from daest.model.holds import Hold
from daest.numerics.parallel import workers

NOISE_ROUNDS = 4  # of searching noise levels and parameters in turn
ASSUMED = (1e2, 1.0, 1e-2, 1e-4)  # of the size of an assumed noise that moves outputs by their own noise
LEADING_SEARCHES = 2  # of its size and of parameters in turn
LEADING_ROUNDS = 10
LEADING_ITERATIONS, LEADING_GAIN = 15, 0.1  # of the search in each
SIMULATION_ITERATIONS = 15  # of the simulation that a search of predictions starts from
HILLS = 1  # looked over after a last search: each costs as much as several of a linear one


def best_ends(
    setup: Setup, problem: TrajectoryProblem, z: np.ndarray, home: np.ndarray, tell: Tell
) -> list[Ending]:
    """The ends of the searches from z and from further starts around `home`, where the user started, best
    first. Error `identify-no-start`. Shapes: z and home (n_z,)."""
    options = setup.options
    starts = [z, *further_starts(problem, home, options)]
    if len(starts) == 1:
        found = [_search_from(setup, problem, home, z)]
    else:
        done = count(1)
        with workers(options.jobs, options.cluster) as pool:
            outcomes = pool.map(
                partial(_search_from, setup, problem, home),
                starts,
                arrived=lambda *_: tell(f"searched from start point ({next(done)} of {len(starts)})"),
            )
            found = [outcome.get() for outcome in outcomes]
    ends = [end for end in found if end is not None]
    if not ends:
        raise no_start()
    return sorted(ends, key=lambda end: rank(end.found))


def search_of(
    problem: TrajectoryProblem, home: np.ndarray, max_iterations: int, enough: float | None = None
) -> Search:
    """What is searched; `home` is where the user started. A search that another one follows ends where the
    next step would gain less than `enough`, and does not look beyond hills. Shapes: home (n_z,)."""
    lower, upper = limits(problem)
    objective = objective_of(problem)
    gain, hills = (FIT.converged_gain, HILLS) if enough is None else (enough, 0)
    return Search(
        objective, problem.unknowns, lower, upper, home, max_iterations, gain, hills, trusts_parabola=True
    )


def _search_from(setup: Setup, problem: TrajectoryProblem, home: np.ndarray, z: np.ndarray) -> Ending | None:
    options = setup.options
    simulated = _simulated(setup, problem, home, z)
    if simulated is None or setup.method == "oe" or simulated.cut is not None:
        return simulated
    problem = simulated.problem
    points = [simulated.found.z]
    if options.second_look and options.max_iterations:
        points += _led(problem, home)
        points += scanned(
            search_of(problem, home, SIMULATION_ITERATIONS, LEADING_GAIN), points[0], options.seed
        )
    end = _predicted(setup, problem, home, points)
    return None if end is None else replace(_settled(setup, end, home), notes=simulated.notes)


def _predicted(
    setup: Setup, problem: TrajectoryProblem, home: np.ndarray, points: list[np.ndarray]
) -> Ending | None:
    """The end of searching noise levels and parameters in turn from the most likely of some points."""
    first, *others = (
        sorted(points, key=lambda z: _rough_value(setup, problem, z)) if len(points) > 1 else points
    )
    end: Ending | None = None
    for number in range(NOISE_ROUNDS):
        z = first if end is None else end.found.z
        # A model that falls over may have come to where no simulation without the gain gets through.
        run = problem if end is None or average_along(problem, z) is not None else end.problem
        tried, levels = with_gain(setup, run, z, None if end is None else end.levels)
        search = search_of(tried, home, setup.options.max_iterations, LEADING_GAIN)
        is_doubtful = partial(is_coloured, tried)
        found = best_point(search, [z], is_doubtful, () if number else others)
        if found is None:
            break
        gain = np.inf if end is None else end.found.evaluation.value - found.evaluation.value
        if gain < 0.0:
            break
        end = Ending(tried, found, levels)
        if gain < FIT.round_gain:
            break
    return end


def _rough_value(setup: Setup, problem: TrajectoryProblem, z: np.ndarray) -> float:
    """Negative log-likelihood at z with the best of a few noise levels."""
    if average_along(problem, z) is None:
        return np.inf
    tried, _ = with_gain(setup, problem, z, None, evaluations=0)
    errors = prediction_errors(tried, z)
    return np.inf if errors is None else errors.negative_log_likelihood


def _simulated(setup: Setup, problem: TrajectoryProblem, home: np.ndarray, z: np.ndarray) -> Ending | None:
    """The end of an output-error search from z, or of one from elsewhere in the range of the parameters where
    the former leaves residuals that are not white."""
    end, options = _simulated_from(setup, problem, home, z), setup.options
    is_last = setup.method == "oe" and options.second_look and options.max_iterations > 0
    has_events = problem.model.explicit.flat.events is not None
    if end is None or end.cut is not None or not is_last or has_events:
        return end
    search, doubt = search_of(end.problem, home, options.max_iterations), partial(is_coloured, end.problem)
    if not doubt(end.found):
        return end
    found = best_point(search, [end.found.z], doubt, scanned(search, end.found.z, options.seed))
    return end if found is None or rank(found) >= rank(end.found) else replace(end, found=found, notes=())


def _simulated_from(
    setup: Setup, problem: TrajectoryProblem, home: np.ndarray, z: np.ndarray
) -> Ending | None:
    """The end of an output-error search: over the whole records, by multiple shooting where that is wanted,
    or by the better of both where the former fails or loses a parameter."""
    options, shooting = setup.options, setup.options.shooting
    # Of a model with events no prediction leans on the record, and no segment begins in a mode that is known.
    has_events = problem.model.explicit.flat.events is not None
    if has_events:
        shooting = 1
    single, led = None, list[np.ndarray]()
    if shooting is None or shooting == 1:
        is_end = setup.method == "oe" or shooting == 1
        iterations = options.max_iterations if is_end else SIMULATION_ITERATIONS
        search = search_of(problem, home, iterations, None if is_end else LEADING_GAIN)
        enough = options.enough if is_end and options.enough is not None else search.converged_gain
        search = replace(search, goal=-options.least, converged_gain=enough)
        leads = is_end and options.second_look and options.max_iterations > 0 and not has_events
        further = _kept(_led(problem, home), led) if leads else ()
        starts = [z, *called_back(problem, z)]
        found = best_point(search, starts, partial(is_coloured, problem), further)
        single = None if found is None else Ending(problem, found, None)
    is_doubtful = _has_lost_one(single, home) or (setup.method == "oe" and _is_poor(single))
    if shooting == 1 or (shooting is None and not is_doubtful):
        return single
    if not problem.n_states:  # nothing that a segment could start from
        return single
    n_segments = shooting or default_segments(problem.experiments)
    cut = _best_cut(problem, [*led, z], n_segments, options.max_iterations)
    ends = [end for end in (single, _uncut(problem, cut, n_segments, home, options)) if end is not None]
    return min(ends, key=lambda end: rank(end.found), default=None)


def is_coloured(problem: TrajectoryProblem, found: Found) -> bool:
    """Whether the errors at the end of a search are not white."""
    errors = prediction_errors(problem, found.z)
    return errors is None or coloured(errors.errors, [np.isfinite(e) for e in errors.errors])


def _led(problem: TrajectoryProblem, home: np.ndarray) -> Iterator[np.ndarray]:
    """Where the searches of predictors end that lean on the record less and less.

    Every state has an assumed noise. First its size is chosen by the likelihood, then it fades as long as
    the predictions become no less likely; a step down that is too long is halved once.
    """
    if not problem.n_states:
        return
    end: tuple[float, np.ndarray, Levels] | None = None
    fading = FIT.fading
    for number in range(LEADING_ROUNDS):
        is_fading = end is not None and number >= LEADING_SEARCHES
        z, levels = (home, None) if end is None else end[1:]
        chosen = assumed(problem, z, levels if is_fading else None, (fading,) if is_fading else ASSUMED)
        found = chosen and best_point(search_of(chosen[0], home, LEADING_ITERATIONS, LEADING_GAIN), [z])
        if chosen and found and (end is None or found.evaluation.value < end[0] + FIT.leading_loss):
            problem = replace(problem, gain=chosen[0].gain)
            end = found.evaluation.value, found.z, chosen[1]
        elif is_fading and fading == FIT.fading:
            fading = float(np.sqrt(FIT.fading))
        else:
            break
    if end is not None:
        yield end[1]


def leaning(problem: TrajectoryProblem, z: np.ndarray) -> tuple[TrajectoryProblem, np.ndarray]:
    """The problem as a predictor that leans on the record where no simulation from the beginning gets through
    it, and z in its scales: a ball under a magnet falls on it within tenths of a second, whatever the values.
    Its gain is that of an assumed noise on every state, where the model can be run over a piece at least.
    Shapes: z (n_z,)."""
    if prediction_errors(problem, z) is not None or not problem.n_states:
        return problem, z
    for length in RUN_LENGTHS:
        pieces = tuple(part_of(e, 0, length) for e in problem.experiments)
        run, there = scaled(replace(problem, experiments=pieces), z)
        chosen = assumed(replace(problem, state_scale=run.state_scale), there, None, ASSUMED, run)
        if chosen is not None:
            return chosen[0], there
    return problem, z


def with_likelier_hold(end: Ending, home: np.ndarray, options: IdentifyOptions) -> Ending:
    """The end of multiple shooting with the hold that is likeliest: short fits of a whole record tell nothing
    of a model too unstable for one. Another hold is searched from where the first has ended, with what was
    lost there put back, and from the user's parameters: the wrong hold may have led far away from them.
    Shapes: home (n_z,)."""
    names, asked = asked_holds(end.problem, options)
    if end.cut is None or len(asked) < 2:
        return end
    ends, n_segments = {end.problem.hold: end}, len(end.cut.shooting.groups[0])
    near, away = end.found.z.copy(), lost(search_of(end.problem, home, 0), end.found)
    near[away] = home[away]
    given, n = end.found.z.copy(), len(end.problem.unknowns.coordinates)
    given[:n] = home[:n]

    def likelihood(hold: Hold) -> float | None:
        if hold not in ends:
            problem = replace(end.problem, hold=hold)
            found = [_shot(problem, z, n_segments, home, options) for z in (near, given)]
            reached = [one for one in found if one is not None]
            if not reached:
                return None
            ends[hold] = min(reached, key=lambda one: rank(one.found))
        return -ends[hold].found.evaluation.value

    in_steps = are_steps(end.problem.experiments, names)
    first = tuple(dict.fromkeys([end.problem.hold, *asked]))
    return ends[ranked_holds(names, likelihood, first, in_steps)[0]]


def _kept(points: Iterator[np.ndarray], kept: list[np.ndarray]) -> Iterator[np.ndarray]:
    """The points (n_z,), each put among those `kept` when it is asked for."""
    for z in points:
        kept.append(z)
        yield z


def _best_cut(
    problem: TrajectoryProblem, starts: list[np.ndarray], n_segments: int, max_iterations: int
) -> Cut | None:
    """The first end of multiple shooting without gaps, from one start (n_z,) after the other; where all leave
    gaps, the most likely one, and None where no segment can be simulated."""
    best: Cut | None = None
    for z in starts:
        cut = search_by_shooting(problem, z, n_segments, max_iterations)
        if cut is not None and cut.is_continuous:
            return cut
        if cut is not None and (best is None or cut.found.evaluation.value < best.found.evaluation.value):
            best = cut
    return best


def _has_lost_one(end: Ending | None, start: np.ndarray) -> bool:
    """Whether a search has lost a parameter: on a way over hills it may end where none was to be."""
    return end is not None and bool(lost(search_of(end.problem, start, 0), end.found))


def _is_poor(end: Ending | None) -> bool:
    """Whether a search by simulation did not converge, or left an output largely unexplained."""
    if end is None or end.found.reason != "converged":
        return True
    errors = prediction_errors(end.problem, end.found.z)
    assert errors is not None
    y = np.concatenate([e.outputs for e in end.problem.experiments])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an output without a value
        left, spread = np.nanstd(np.concatenate(errors.errors), axis=0), np.nanstd(y, axis=0)
    return bool(np.any(left > FIT.poor_simulation * spread))


def _shot(
    problem: TrajectoryProblem, z: np.ndarray, n_segments: int, home: np.ndarray, options: IdentifyOptions
) -> Ending | None:
    """The end of multiple shooting from z (n_z,) that closes all gaps; None where it does not."""
    cut = search_by_shooting(problem, z, n_segments, options.max_iterations)
    return _uncut(problem, cut, n_segments, home, options) if cut and cut.is_continuous else None


def _uncut(
    problem: TrajectoryProblem, cut: Cut | None, n_segments: int, home: np.ndarray, options: IdentifyOptions
) -> Ending | None:
    """The end of multiple shooting as a simulation of the whole records, searched on from there; the cut one
    where the model is too unstable for that."""
    if cut is None:
        return None
    note = (f"found by multiple shooting ({n_segments} segments)",)
    problem = replace(problem, state_scale=cut.shooting.problem.state_scale)
    z = start_of(cut.shooting, cut.found.z)
    found = best_point(search_of(problem, home, options.max_iterations), [z])
    if not cut.is_continuous:
        gaps = "multiple shooting did not close all gaps: searched on from there over the whole records"
        return None if found is None else Ending(problem, found, None, notes=(gaps,))
    if found is not None and found.evaluation.value < cut.found.evaluation.value + FIT.same_shooting:
        return Ending(problem, found, None, notes=note)
    unstable = "too unstable to be simulated from one initial state: errors are those of the joined segments"
    return Ending(problem, replace(cut.found, z=z), None, cut, (*note, unstable))


def _settled(setup: Setup, end: Ending, home: np.ndarray) -> Ending:
    """The end with the gain of its own levels at its own parameters, and the levels at the size of its
    innovations: a filter with these levels then is the predictor of the fit."""
    if end.levels is None:
        return end
    average = average_along(end.problem, end.found.z)
    assert average is not None
    found = observer(average, end.levels.intensity, end.levels.measurement_std)
    if found is None:
        return end
    problem = gained(end.problem, found)
    again = best_point(search_of(problem, home, setup.options.max_iterations), [end.found.z])
    if again is None:
        return end
    errors = prediction_errors(problem, again.z)
    levels = end.levels if errors is None else at_size_of_innovations(setup, errors, end.levels, found)
    return Ending(problem, again, levels)
