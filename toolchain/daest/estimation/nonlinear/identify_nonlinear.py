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

from daest.errors import EstimationError
from daest.estimation.fitting.coordinates import Unknowns, objective, prior_penalty, rescaled
from daest.estimation.fitting.optimum import WAKING, best_point, rank
from daest.estimation.fitting.profile import Tell, silent
from daest.estimation.fitting.records import part_of
from daest.estimation.fitting.result import assembled, fit_result
from daest.estimation.fitting.search import Evaluation, free_coordinates, minimise, whole_step
from daest.estimation.fitting.setup import NO_INFLUENCE, Setup, no_start
from daest.estimation.gates import FIT
from daest.estimation.nonlinear.gain_family import Levels
from daest.estimation.nonlinear.noise_levels import (
    Ending,
    average_along,
    free_gains,
    with_family,
    with_gain,
    without_family,
)
from daest.estimation.nonlinear.nonlinear_result import AGREEMENT_ITERATIONS, NonlinearEnds
from daest.estimation.nonlinear.nonlinear_search import best_ends, leaning, search_of, with_likelier_hold
from daest.estimation.nonlinear.nonlinear_start import (
    check_nonlinear_start,
    limits,
    scaled,
    started,
    unscaled_start,
    with_hold,
    with_other_hold,
    with_outgrown_scales,
    with_sized_effects,
)
from daest.estimation.nonlinear.observer import AverageModel
from daest.estimation.nonlinear.trajectories import TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FitResult, IdentifyOptions
from daest.model.flat import Dynamics
from daest.model.holds import Hold
from daest.systems.reduction.input_slopes import acting_slopes
from daest.systems.simulation.integrate import integrator
from daest.systems.tolerances import SOLVER

# Of the integration in a search that starts warm. With dry friction in a servo a prediction is then off by at
# most 1e-3 of its innovation and the log-likelihood by 0.01, in two thirds of the steps that the tolerance of
# a cold search takes near zero.
WARM_RTOL, WARM_ATOL_OF_SCALE = 1e-4, 0.1
ROUGH_ITERATIONS = 8
START_STEPS = 3  # of a search for initial states alone
SHORT = 0.25  # of the recordings, over which a further start shows first whether it can win ...
FEWEST_IN_SHORT = 500  # ... where that part has as many samples
WARM_ROUNDS = 4
HOLD_ROUNDS = 2  # of searches with the hold that is likelier at the end of the last one
LEVEL_ITERATIONS = 15  # of the last search over noise levels alone


@dataclass(frozen=True)
class WarmStart:
    """Where a prediction-error search starts when a similar model has been fitted before: noise levels and
    the initial state of every experiment by state name. A first pass that ends below the log-likelihood
    `hopeless` is the last, and a search ends where it gains too little to come up to `least`. The simulations
    that validate begin with the states `at_rest` at zero: they stand for noise. `shares` of the intensity are
    started from: what the similar model called noise may now be explained, so that next to none is the other
    start. A search that `is_rough` ends with its first pass. Where the initial states `stand_beside` loads
    that the model does not have, those of the model alone are looked for first: what a load has held where
    it is for the whole record lets go at the first sample."""

    intensity: np.ndarray  # (n_w,)
    measurement_std: np.ndarray  # (n_y,)
    initial_states: tuple[Mapping[str, float], ...]
    at_rest: tuple[str, ...] = ()
    hopeless: float = -np.inf
    least: float = -np.inf
    shares: tuple[float, ...] = (1.0, FIT.explained_noise)
    is_rough: bool = False
    stand_beside: bool = False

    @property
    def levels(self) -> Levels:
        return Levels(self.intensity, self.measurement_std)


def identify_nonlinear(explicit: Dynamics, setup: Setup, tell: Tell = silent) -> FitResult:
    """Fit the unknown parameters of a nonlinear model. Raises EstimationError `identify-no-start`,
    `identify-no-influence`, `identify-unidentifiable`."""
    began = time.perf_counter()
    return fit_result(setup, nonlinear_ends(explicit, setup, tell), tell, began)


def nonlinear_start(explicit: Dynamics, setup: Setup) -> tuple[Setup, TrajectoryProblem, np.ndarray]:
    """The setup in scales of the data, and the simulation that a search begins with, at the start values
    (n_z,): no hold is chosen yet."""
    unscaled = with_sized_effects(_problem(explicit, setup))

    def at_start() -> Evaluation | None:
        return objective(unscaled)(unscaled_start(unscaled), True)

    unknowns = rescaled(unscaled.unknowns, at_start, setup.n_observed)
    # The search that follows moves the initial states, too: where it is rough, so is its start.
    enough = FIT.converged_gain if setup.options.rtol is None else FIT.rough_start_gain
    problem, z = started(replace(unscaled, unknowns=unknowns), enough)
    setup = replace(setup, unknowns=unknowns.with_initial_of(setup.unknowns))
    return setup, problem, z


def _checked_start(setup: Setup, problem: TrajectoryProblem, z: np.ndarray, home: np.ndarray) -> np.ndarray:
    """z, where short fits have led, or `home` if they have led to where a parameter does nothing. Errors of
    `check_nonlinear_start`. Shapes: z, home and the start (n_z,)."""
    may_be_cut = setup.method == "oe" and setup.options.shooting != 1
    try:
        check_nonlinear_start(problem, z, may_be_cut=may_be_cut)
        return z
    except EstimationError:
        if np.array_equal(z, home):
            raise
    check_nonlinear_start(problem, home, may_be_cut=may_be_cut)
    return home


def awake_start(explicit: Dynamics, setup: Setup) -> Setup | None:
    """The setup from where all parameters act: its own start values, or with those that do nothing
    there moved one after the other, by a factor of two and more. None where one does nothing anywhere."""
    idle = _idle(explicit, setup)
    for factor in (2.0 ** (side * power) for power in range(1, WAKING + 1) for side in (-1, 1)):
        for name in idle:
            unknowns = setup.unknowns
            one = next(c for c in unknowns.coordinates if c.name == name)
            value = min(max(factor * one.initial, one.lower), one.upper)
            tried = replace(setup, unknowns=unknowns.started_at({name: value}))
            left = idle if value == one.initial else _idle(explicit, tried)
            if name not in left and len(left) < len(idle):
                setup, idle = tried, left
    return None if idle else setup


def _idle(explicit: Dynamics, setup: Setup) -> list[str]:
    """Parameters that do nothing at the start values. Raises what `check_nonlinear_start` finds otherwise."""
    setup, problem, z = nonlinear_start(explicit, setup)
    try:
        _checked_start(setup, problem, z, z)
    except EstimationError as error:
        if error.code != NO_INFLUENCE:
            raise
        return str(error.where).split(", ")
    return []


def nonlinear_ends(explicit: Dynamics, setup: Setup, tell: Tell = silent) -> NonlinearEnds:
    """The ends of the searches of `identify_nonlinear`, which raises the same."""
    setup, problem, home = nonlinear_start(explicit, setup)
    problem, z = with_hold(problem, home, setup.options)
    if setup.method == "pem" and setup.intensity.size and setup.options.shooting is None:
        leant, there = leaning(problem, z)
        if leant is not problem:  # in scales of its own, and nothing runs at home
            problem, z, home = leant, there, there
    z = _checked_start(setup, problem, z, home)
    ends = best_ends(setup, problem, z, home, tell)
    for _ in range(HOLD_ROUNDS if setup.options.max_iterations else 0):
        best = ends[0]
        if best.cut is not None:
            ends[0] = with_likelier_hold(best, home, setup.options)
            hold = ends[0].problem.hold
            if hold != best.problem.hold:
                again = best_ends(setup, replace(problem, hold=hold), home, home, tell)
                ends = min(ends, again, key=lambda found: rank(found[0].found))
            break
        turned = with_other_hold(best.problem, best.found, setup.options)
        if turned is None:
            break
        hold, start = turned
        ends = best_ends(setup, replace(problem, hold=hold), start[: z.size], home, tell)
    return NonlinearEnds(setup, ends)


def _problem(explicit: Dynamics, setup: Setup) -> TrajectoryProblem:
    """Without a given hold, with held inputs if the model can be driven by them."""
    names = setup.unknowns.parameter_names()
    first: Hold = "foh" if acting_slopes(explicit, names, setup.unknowns.theta) else "zoh"
    return TrajectoryProblem(
        integrator(explicit, names),
        setup.experiments,
        setup.options.hold or first,
        setup.unknowns,
        np.ones(explicit.n_states),
        setup.given_std,
        rtol=setup.options.rtol or SOLVER.search_rtol,
    )


@dataclass(frozen=True)
class Refit:
    """The end of a search that started from a similar model. `fit` tells no agreement with data: that takes a
    search for initial states of its own, and most refits are followed by a further one."""

    fit: FitResult
    ends: NonlinearEnds

    def simulated(
        self, validation: Sequence[Experiment] = (), iterations: int = AGREEMENT_ITERATIONS
    ) -> FitResult:
        """The fit with its agreement in simulation, from initial states that are searched in so many
        `iterations`."""
        found = self._agreements(validation, with_gain=False, iterations=iterations)
        return replace(self.fit, simulated=found)

    def judged(self, validation: Sequence[Experiment] = ()) -> FitResult:
        """The fit with its agreement in simulation and in predictions of one step."""
        return replace(self.simulated(validation), one_step=self._agreements(validation, with_gain=True))

    def _agreements(
        self,
        validation: Sequence[Experiment],
        *,
        with_gain: bool,
        iterations: int = AGREEMENT_ITERATIONS,
    ) -> dict[str, Agreement]:
        parts = {"estimation": None} | ({"validation": tuple(validation)} if validation else {})
        return {
            name: self.ends.agreement(part, with_gain=with_gain, iterations=iterations)
            for name, part in parts.items()
        }


def search_on(
    explicit: Dynamics,
    unknowns: Unknowns,
    experiments: Sequence[Experiment],
    estimate_intensity: np.ndarray,
    options: IdentifyOptions,
    warm: WarmStart,
) -> Refit:
    """Fit `unknowns` (parameters) of a nonlinear model by predictions ("pem"), from the `warm` start that a
    similar model gives; every measurement noise is estimated, of the intensities those that
    `estimate_intensity` (n_w,) tells. Raises EstimationError `identify-no-start`."""
    began = time.perf_counter()
    n_y = len(explicit.flat.outputs)
    std, is_estimated = np.full(n_y, np.nan), np.ones(n_y, dtype=bool)
    known = (warm.intensity, estimate_intensity, std, is_estimated)
    setup = Setup(unknowns, tuple(experiments), "pem", *known, options)
    ends = NonlinearEnds(setup, [_search_on(setup, _problem(explicit, setup), warm)], warm.at_rest)
    return Refit(replace(assembled(setup, ends, {}), seconds=time.perf_counter() - began), ends)


def _search_on(setup: Setup, problem: TrajectoryProblem, warm: WarmStart) -> Ending:
    """Prediction-error search from the noise levels and initial states of a similar model.

    Parameters, initial states and noise levels are searched together, with the gains of one average
    linearisation after the other: roughly from every share of the noise, then on from the best end.
    """
    options = setup.options
    names = problem.model.explicit.state_names
    x0 = [np.array([state.get(name, 0.0) for name in names]) for state in warm.initial_states]
    problem = replace(problem, rtol=WARM_RTOL)
    problem, z = scaled(problem, np.concatenate([problem.unknowns.start, *x0]))
    problem = replace(problem, atol_of_scale=WARM_ATOL_OF_SCALE)
    problem, z = leaning(problem, z)
    average = average_along(problem, z)
    if warm.stand_beside:
        z = _alone(setup, problem, z, warm.levels, average)
    ends: list[Ending] = []
    for share in warm.shares:
        intensity = np.where(setup.estimate_intensity, share * warm.intensity, warm.intensity)
        levels = Levels(intensity, warm.measurement_std)
        if ends and _loses_in_short(setup, problem, z, levels, average, ends[-1]):
            continue
        end = _together(setup, problem, z, levels, average, ROUGH_ITERATIONS, FIT.rough_gain)
        ends += [] if end is None else [end]
    if not ends:
        raise no_start()
    best = min(ends, key=lambda e: e.found.evaluation.value)
    if warm.is_rough:
        return best
    if -best.found.evaluation.value < warm.hopeless:
        return _with_own_gain(setup, best, warm)
    for number in range(WARM_ROUNDS):
        average = average_along(best.problem, best.found.z)
        levels = (best.levels or warm.levels) if number else _rescanned(setup, best, warm)
        grown, start = with_outgrown_scales(best.problem, best.found.z)
        problem = replace(problem, state_scale=grown.state_scale)
        end = _together(setup, problem, start, levels, average, options.max_iterations, FIT.warm_gain)
        gain = -np.inf if end is None else best.found.evaluation.value - end.found.evaluation.value
        if end is None or gain < 0.0:
            break
        best = end
        if gain < FIT.refit_round_gain:
            break
        if -best.found.evaluation.value + gain * (WARM_ROUNDS - 1 - number) < warm.least:
            return _with_own_gain(setup, best, warm)
    search = search_of(best.problem, z, options.max_iterations, FIT.warm_gain)
    best = replace(best, found=best_point(search, [best.found.z]) or best.found)
    return _with_own_gain(setup, best, warm)


def _alone(
    setup: Setup, problem: TrajectoryProblem, z: np.ndarray, levels: Levels, average: AverageModel | None
) -> np.ndarray:
    """z with the initial states that suit its parameters and noise `levels`, where these are far from them
    and whole steps lead there: of a model that is affine the first one does, while a search for everything at
    once, whose steps are short where states do nearly alike, creeps. Shapes: z (n_z,)."""
    family = None if average is None else free_gains(setup, average, levels)
    if family is not None and family.at(np.zeros(family.n_logs)) is not None:
        problem = with_family(problem, family)
    value, n_logs = objective(problem), 0 if problem.family is None else problem.family.n_logs
    best, n = np.concatenate([z, np.zeros(n_logs)]), len(problem.unknowns.coordinates)
    lower, upper = limits(problem)
    enough = FIT.misplaced_start * setup.n_observed
    here = value(best, True)
    for _ in range(START_STEPS):
        if here is None:
            break
        own = free_coordinates(best, here, lower, upper)
        own[:n] = own[z.size :] = False
        step, promised = whole_step(here, own)
        moved = np.clip(best + step, lower, upper)
        there = value(moved, True) if promised > enough else None
        if there is None or here.value - there.value < enough:
            break
        best, here = moved, there
    return best[: z.size]


def _loses_in_short(
    setup: Setup,
    problem: TrajectoryProblem,
    z: np.ndarray,
    levels: Levels,
    average: AverageModel | None,
    known: Ending,
) -> bool:
    """Whether a search from `levels` over the first part of the recordings stays below what the `known` end,
    which was searched over all of them, is worth there."""
    cuts = [round(SHORT * e.n_samples) for e in problem.experiments]
    if sum(cuts) < FEWEST_IN_SHORT:
        return False
    parts = tuple(part_of(e, 0, cut) for e, cut in zip(problem.experiments, cuts, strict=True))
    there = objective(replace(known.problem, experiments=parts))(known.found.z, False)
    if there is None:
        return False
    short = replace(problem, experiments=parts)
    end = _together(setup, short, z, levels, average, ROUGH_ITERATIONS, FIT.rough_gain, there.value)
    return end is not None and there.value < end.found.evaluation.value


def _together(
    setup: Setup,
    problem: TrajectoryProblem,
    z: np.ndarray,
    levels: Levels,
    average: AverageModel | None,
    iterations: int,
    enough: float,
    goal: float = np.inf,
) -> Ending | None:
    """The end of a search over z and the noise levels from `levels`, with the gains of `average`; over z
    alone where it has none. It ends early where it will not come down to the `goal`."""
    family = None if average is None else free_gains(setup, average, levels)
    if family is not None and family.at(np.zeros(family.n_logs)) is not None:
        wide = with_family(problem, family)
        start = np.concatenate([z, np.zeros(family.n_logs)])
        found = minimise(objective(wide), start, *limits(wide), iterations, enough, goal)
        if found is not None:
            return without_family(setup, wide, found)
    # Gains have no slopes beside a mode that no output sees and that neither grows nor fades: the charges of
    # equal cells may differ by anything.
    found = minimise(objective(problem), z, *limits(problem), iterations, enough, goal)
    return None if found is None else Ending(problem, found, levels)


def _rescanned(setup: Setup, end: Ending, warm: WarmStart) -> Levels:
    """The levels of an end, or those of the similar model with less noise of the process if they are more
    likely: slopes lead to the nearest valley only, and what its parameters are worth shows with the noise
    that they leave."""
    problem, levels = with_gain(setup, end.problem, end.found.z, warm.levels, warm.levels, evaluations=0)
    errors = prediction_errors(problem, end.found.z)
    least = end.found.evaluation.value - prior_penalty(problem.unknowns, end.found.z)
    if levels is None or errors is None or errors.negative_log_likelihood >= least:
        return end.levels or warm.levels
    return levels


def _with_own_gain(setup: Setup, end: Ending, warm: WarmStart) -> Ending:
    """The end with the gain of the best noise levels at its own parameters.

    While parameters are searched, the linearisation behind the gains is held. A parameter that only changes
    its scale then changes which noise a gain stands for, and buys likelihood that no noise levels have: the
    judgement is by the gain that they give.
    """
    average = average_along(end.problem, end.found.z)
    family = None if average is None else free_gains(setup, average, end.levels or warm.levels)
    if family is None:
        return end
    unknowns = end.problem.unknowns
    wide = with_family(end.problem.held_at(end.found.z), family)
    states = end.found.z[len(unknowns.coordinates) :]
    lower, upper = limits(wide)
    lower[: states.size] = upper[: states.size] = states
    start = np.concatenate([states, np.zeros(family.n_logs)])
    found = minimise(objective(wide), start, lower, upper, LEVEL_ITERATIONS, FIT.warm_gain)
    if found is None:
        return end
    own = without_family(setup, wide, found)
    value = own.found.evaluation.value + prior_penalty(unknowns, end.found.z)
    evaluation = replace(end.found.evaluation, value=value)
    return Ending(
        replace(own.problem, unknowns=unknowns, holds_parameters=False),
        replace(end.found, evaluation=evaluation),
        own.levels,
    )
