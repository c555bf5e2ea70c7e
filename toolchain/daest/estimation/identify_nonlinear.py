"""Identify a nonlinear model: output error by simulation, or one-step prediction error with an observer.

"oe" minimises the simulation error, report (2). "pem" predicts one step with the stationary gain of the
average linearisation; the gain follows from the noise levels, which are searched for in turn with the
parameters, and every gain gives a valid predictor, so that the likelihoods of different noise levels can be
compared.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

import numpy as np

from daest.estimation import trajectories
from daest.estimation.checks import no_start
from daest.estimation.coordinates import Unknowns, lost_ones
from daest.estimation.interval_check import with_interval_check
from daest.estimation.noise_levels import (
    Ending,
    Levels,
    NonlinearSetup,
    at_size_of_innovations,
    average_along,
    gained,
    with_gain,
)
from daest.estimation.nonlinear_result import agreement, nonlinear_result
from daest.estimation.nonlinear_start import (
    check_nonlinear_start,
    further_starts,
    limits,
    scaled,
    started,
    with_hold,
)
from daest.estimation.observer import AverageModel, observer
from daest.estimation.priors import prior_penalty
from daest.estimation.profile import Searched, Tell, silent, with_profiles
from daest.estimation.search import minimise
from daest.estimation.shooting import Cut, default_segments, search_by_shooting, start_of
from daest.estimation.trajectories import TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions, Method
from daest.model.flat import ExplicitModel
from daest.numerics.parallel import workers
from daest.systems.integrate import integrator

NOISE_ROUNDS = 2  # of searching noise levels and parameters in turn
WARM_RTOL = 1e-4  # of the integration in a search that starts warm: far below the noise of a measurement
ROUGH_ITERATIONS = 8
ROUGH_GAIN = 1.0
WARM_GAIN = 0.02  # predicted gain in log-likelihood at which a warm search ends
WARM_ROUNDS = 4
ENOUGH_GAIN = 1.0  # in log-likelihood: a round that gains less is the last
POOR = 0.5  # of the spread of an output: a simulation that leaves more is tried by multiple shooting
SAME_END = 1.0  # in log-likelihood, between the joined segments and the simulation that they lead to
NEARLY_NONE = 1e-6  # of the noise intensity of a similar model


@dataclass(frozen=True)
class WarmStart:
    """Where a prediction-error search starts when a similar model has been fitted before: noise levels and
    the initial state of every experiment by state name. `noise_evaluations` limits the search over noise
    levels. A first pass that ends below the log-likelihood `hopeless` is the last. The simulations that
    validate begin with the states `at_rest` at zero: they stand for noise."""

    intensity: np.ndarray  # (n_w,)
    measurement_std: np.ndarray  # (n_y,)
    initial_states: tuple[Mapping[str, float], ...]
    noise_evaluations: int = 30
    at_rest: tuple[str, ...] = ()
    hopeless: float = -np.inf

    @property
    def levels(self) -> Levels:
        return Levels(self.intensity, self.measurement_std)


def identify_nonlinear(
    explicit: ExplicitModel,
    unknowns: Unknowns,
    experiments: Sequence[Experiment],
    method: Method,
    intensity: np.ndarray,
    estimate_intensity: np.ndarray,
    given_std: np.ndarray,
    options: IdentifyOptions,
    validation: Sequence[Experiment] = (),
    warm: WarmStart | None = None,
    tell: Tell = silent,
) -> FitResult:
    """Fit `unknowns` (parameters) of a nonlinear model; experiments are in the model's order of signals.

    intensity (n_w,) with NaN where unknown, estimate_intensity (n_w,) bool, given_std (n_y,) with NaN where
    estimated. Raises EstimationError `identify-no-start`, `identify-no-influence`, `identify-unidentifiable`.
    """
    began = time.perf_counter()
    model = integrator(explicit, unknowns.parameter_names())
    problem = TrajectoryProblem(
        model, tuple(experiments), options.hold or "zoh", unknowns, np.ones(explicit.n_states), given_std
    )
    setup = NonlinearSetup(problem, method, intensity, estimate_intensity, ())
    if warm is None:
        problem, z = started(problem)
        problem, z = with_hold(problem, z, options)
        check_nonlinear_start(problem, z, may_be_cut=method == "oe" and options.shooting != 1)
        setup = replace(setup, problem=problem)
        ends = _search(setup, z, options, tell)
    else:
        ends = [_search_on(setup, warm, options)]
    best = ends[0]
    simulated = {"estimation": agreement(best, best.problem.experiments, with_gain=False)}
    one_step = {"estimation": agreement(best, best.problem.experiments, with_gain=True)}
    if validation:
        at_rest = () if warm is None else warm.at_rest
        simulated["validation"] = agreement(best, tuple(validation), with_gain=False, at_rest=at_rest)
        one_step["validation"] = agreement(best, tuple(validation), with_gain=True)
    result = nonlinear_result(setup, ends, simulated, one_step)
    searched = Searched(trajectories.objective(best.problem), unknowns, *limits(best.problem), best.found)
    if warm is None and best.cut is None:
        result = with_interval_check(result, searched)
    if options.profile and best.cut is not None:
        note = "no profile likelihood: the model is too unstable to be simulated from one initial state"
        result = replace(result, notes=(*result.notes, note))
    elif options.profile:
        result = with_profiles(result, searched, options.profile, tell)
    return replace(result, seconds=time.perf_counter() - began)


def _search(setup: NonlinearSetup, z: np.ndarray, options: IdentifyOptions, tell: Tell) -> list[Ending]:
    starts = [z, *further_starts(setup.problem, z, options)]
    if len(starts) == 1:
        found = [_search_from(setup, z, options)]
    else:
        done = count(1)
        with workers(options.jobs, options.cluster) as pool:
            outcomes = pool.map(
                partial(_search_from, setup, options=options),
                starts,
                arrived=lambda *_: tell(f"searched from start point ({next(done)} of {len(starts)})"),
            )
            found = [outcome.get() for outcome in outcomes]
    ends = [end for end in found if end is not None]
    if not ends:
        raise no_start()
    return sorted(ends, key=lambda end: end.found.evaluation.value)


def _search_from(setup: NonlinearSetup, z: np.ndarray, options: IdentifyOptions) -> Ending | None:
    simulated = _simulated(setup, z, options)
    if simulated is None or setup.method == "oe" or simulated.cut is not None:
        return simulated
    setup, found = replace(setup, problem=simulated.problem), simulated.found
    problem = setup.problem
    lower, upper = limits(problem)
    levels: Levels | None = None
    for _ in range(NOISE_ROUNDS):
        problem, levels = with_gain(setup, found.z, levels)
        again = minimise(trajectories.objective(problem), found.z, lower, upper, options.max_iterations)
        found = again or found
    return _settled(setup, Ending(problem, found, levels, notes=simulated.notes), options)


def _simulated(setup: NonlinearSetup, z: np.ndarray, options: IdentifyOptions) -> Ending | None:
    """The end of an output-error search: over the whole records, by multiple shooting where that is wanted,
    or by the better of both where the former fails or loses a parameter."""
    problem, shooting = setup.problem, options.shooting
    single = None
    if shooting is None or shooting == 1:
        lower, upper = limits(problem)
        found = minimise(trajectories.objective(problem), z, lower, upper, options.max_iterations)
        single = None if found is None else Ending(problem, found, None)
    is_doubtful = _has_lost_one(single, z) or (setup.method == "oe" and _is_poor(single))
    if shooting == 1 or (shooting is None and not is_doubtful):
        return single
    if not problem.n_states:  # nothing that a segment could start from
        return single
    n_segments = shooting or default_segments(problem.experiments)
    cut = search_by_shooting(problem, z, n_segments, options.max_iterations)
    ends = [end for end in (single, _uncut(problem, cut, n_segments, options)) if end is not None]
    return min(ends, key=lambda end: end.found.evaluation.value, default=None)


def _has_lost_one(end: Ending | None, start: np.ndarray) -> bool:
    """Whether a search has lost a parameter: on a way over hills it may end where none was to be."""
    return end is not None and bool(lost_ones(end.problem.unknowns, end.found.z, start))


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
    return bool(np.any(left > POOR * spread))


def _uncut(
    problem: TrajectoryProblem, cut: Cut | None, n_segments: int, options: IdentifyOptions
) -> Ending | None:
    """The end of multiple shooting as a simulation of the whole records, searched on from there; the cut one
    where the model is too unstable for that."""
    if cut is None:
        return None
    note = (f"found by multiple shooting ({n_segments} segments)",)
    problem = replace(problem, state_scale=cut.shooting.problem.state_scale)
    z = start_of(cut.shooting, cut.found.z)
    lower, upper = limits(problem)
    found = minimise(trajectories.objective(problem), z, lower, upper, options.max_iterations)
    if not cut.is_continuous:
        gaps = "multiple shooting did not close all gaps: searched on from there over the whole records"
        return None if found is None else Ending(problem, found, None, notes=(gaps,))
    if found is not None and found.evaluation.value < cut.found.evaluation.value + SAME_END:
        return Ending(problem, found, None, notes=note)
    unstable = "too unstable to be simulated from one initial state: errors are those of the joined segments"
    return Ending(problem, replace(cut.found, z=z), None, cut, (*note, unstable))


def _settled(setup: NonlinearSetup, end: Ending, options: IdentifyOptions) -> Ending:
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
    lower, upper = limits(problem)
    again = minimise(trajectories.objective(problem), end.found.z, lower, upper, options.max_iterations)
    if again is None:
        return end
    errors = prediction_errors(problem, again.z)
    levels = end.levels if errors is None else at_size_of_innovations(setup, errors, end.levels, found)
    return Ending(problem, again, levels)


def _search_on(setup: NonlinearSetup, warm: WarmStart, options: IdentifyOptions) -> Ending:
    """Prediction-error search from the noise levels and initial states of a similar model.

    What the similar model called noise may now be explained, so that the search starts both from its noise
    levels and from next to none, and goes on from the better end: noise levels and parameters in turn.
    """
    problem = setup.problem
    names = problem.model.explicit.state_names
    x0 = [np.array([state.get(name, 0.0) for name in names]) for state in warm.initial_states]
    problem, z = scaled(problem, np.concatenate([problem.unknowns.start, *x0]))
    problem = replace(problem, rtol=WARM_RTOL)
    average = average_along(problem, z)
    ends = []
    for share in (1.0, NEARLY_NONE):
        intensity = np.where(setup.estimate_intensity, share * warm.intensity, warm.intensity)
        end = _search_at(problem, z, Levels(intensity, warm.measurement_std), average)
        ends += [] if end is None else [end]
    if not ends:
        raise no_start()
    best = min((_rescanned(setup, end, warm) for end in ends), key=lambda e: e.found.evaluation.value)
    for _ in range(WARM_ROUNDS if -best.found.evaluation.value > warm.hopeless else 0):
        around = replace(setup, problem=best.problem)
        start = Levels(warm.intensity if best.levels is None else best.levels.intensity, warm.measurement_std)
        improved_problem, levels = with_gain(around, best.found.z, warm.levels, start, warm.noise_evaluations)
        lower, upper = limits(improved_problem)
        found = minimise(
            trajectories.objective(improved_problem),
            best.found.z,
            lower,
            upper,
            options.max_iterations,
            WARM_GAIN,
        )
        if found is None or best.found.evaluation.value - found.evaluation.value < 0.0:
            break
        improved = best.found.evaluation.value - found.evaluation.value
        best = Ending(improved_problem, found, levels)
        if improved < ENOUGH_GAIN:
            break
    return best if -best.found.evaluation.value < warm.hopeless else _with_own_gain(setup, best, warm)


def _with_own_gain(setup: NonlinearSetup, end: Ending, warm: WarmStart) -> Ending:
    """The end with the gain of the best noise levels at its own parameters.

    While parameters are searched, the gain is held. One that only changes their scale then changes which
    noise it stands for, and buys likelihood that no noise levels have: the judgement is by the gain that
    they give.
    """
    around, start = replace(setup, problem=end.problem), end.levels or warm.levels
    problem, levels = with_gain(around, end.found.z, start, start, warm.noise_evaluations)
    errors = prediction_errors(problem, end.found.z)
    if errors is None:
        return end
    value = errors.negative_log_likelihood + prior_penalty(problem.unknowns, end.found.z)
    evaluation = replace(end.found.evaluation, value=value)
    return Ending(problem, replace(end.found, evaluation=evaluation), levels)


def _rescanned(setup: NonlinearSetup, end: Ending, warm: WarmStart) -> Ending:
    """The end with the best of a few noise levels: what its parameters are worth shows only with the noise
    that they leave, not with the noise that they were found under."""
    around = replace(setup, problem=end.problem)
    problem, levels = with_gain(around, end.found.z, warm.levels, warm.levels, evaluations=0)
    errors = prediction_errors(problem, end.found.z)
    if errors is None:
        return end
    value = errors.negative_log_likelihood + prior_penalty(problem.unknowns, end.found.z)
    if value >= end.found.evaluation.value:
        return end
    evaluation = replace(end.found.evaluation, value=value)
    return Ending(problem, replace(end.found, evaluation=evaluation), levels)


def _search_at(
    problem: TrajectoryProblem, z: np.ndarray, levels: Levels, average: AverageModel | None
) -> Ending | None:
    """Rough search of the parameters with the gain of given noise levels, if `average` gives one."""
    found_gain = None if average is None else observer(average, levels.intensity, levels.measurement_std)
    if found_gain is not None:
        problem = gained(problem, found_gain)
    lower, upper = limits(problem)
    found = minimise(trajectories.objective(problem), z, lower, upper, ROUGH_ITERATIONS, ROUGH_GAIN)
    return None if found is None else Ending(problem, found, levels)
