"""Identify a nonlinear model: output error by simulation, or one-step prediction error with an observer.

"oe" minimises the simulation error, report (2). "pem" predicts one step with the stationary gain of the
average linearisation; the gain follows from the noise levels, which are searched for in turn with the
parameters, and every gain gives a valid predictor, so that the likelihoods of different noise levels can be
compared.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.estimation import trajectories
from daest.estimation.checks import no_start
from daest.estimation.coordinates import Unknowns, prior_penalty
from daest.estimation.noise_levels import (
    Ending,
    Levels,
    NonlinearSetup,
    average_along,
    gained,
    with_gain,
)
from daest.estimation.nonlinear_result import agreement, nonlinear_result
from daest.estimation.nonlinear_search import best_ends, search_of
from daest.estimation.nonlinear_start import (
    check_nonlinear_start,
    limits,
    scaled,
    started,
    with_hold,
)
from daest.estimation.observer import AverageModel, observer
from daest.estimation.optimum import best_point
from daest.estimation.profile import Searched, Tell, silent, with_interval_check, with_profiles
from daest.estimation.search import minimise
from daest.estimation.trajectories import TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions, Method
from daest.model.flat import Dynamics
from daest.systems.integrate import integrator

WARM_RTOL = 1e-4  # of the integration in a search that starts warm: far below the noise of a measurement
ROUGH_ITERATIONS = 8
ROUGH_GAIN = 1.0
WARM_GAIN = 0.02  # predicted gain in log-likelihood at which a warm search ends
WARM_ROUNDS = 4
ENOUGH_GAIN = 1.0  # in log-likelihood: a round that gains less is the last
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
    explicit: Dynamics,
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
        ends = best_ends(setup, z, options, tell)
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
    if -best.found.evaluation.value < warm.hopeless:
        return best
    settled = best_point(search_of(best.problem, z, options.max_iterations, WARM_GAIN), [best.found.z])
    return _with_own_gain(setup, replace(best, found=settled or best.found), warm)


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
