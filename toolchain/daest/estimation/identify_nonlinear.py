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
from scipy.optimize import minimize

from daest.errors import EstimationError
from daest.estimation import trajectories
from daest.estimation.coordinates import Coordinate, Unknowns
from daest.estimation.identifiability import (
    WEAK_RELATIVE_STD,
    correlation,
    covariance,
    flat_directions,
    output_error_covariance,
    weak_directions,
    without_influence,
)
from daest.estimation.observer import AverageModel, average_model, observer
from daest.estimation.result import bound_of, message_of
from daest.estimation.scores import Scores, scores
from daest.estimation.search import Found, minimise
from daest.estimation.trajectories import TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.explicit import ExplicitModel
from daest.model.fit import (
    Agreement,
    FitResult,
    FittedInitialState,
    FittedNoise,
    FittedParameter,
    IdentifyOptions,
    Method,
)
from daest.systems.initialize import initial_point
from daest.systems.integrate import Hold, integrator, interval_inputs

FIRST_LENGTH = 500  # samples of the fit that finds the initial state before the whole record is used
SHORT_LENGTH = 100  # samples that also must show a direction as flat before it is called unidentifiable
HOLD_ITERATIONS = 6
NOISE_ROUNDS = 2  # of searching noise levels and parameters in turn
NOISE_EVALUATIONS = 40  # of the simplex search over noise levels in each round
NOISE_SPREAD = np.log(10.0)  # first step of that search
WARM_RTOL = 1e-4  # of the integration in a search that starts warm: far below the noise of a measurement
ROUGH_ITERATIONS = 8
ROUGH_GAIN = 1.0
WARM_GAIN = 0.02  # predicted gain in log-likelihood at which a warm search ends
WARM_ROUNDS = 4
ENOUGH_GAIN = 1.0  # in log-likelihood: a round that gains less is the last
NEARLY_NONE = 1e-6  # of the noise intensity of a similar model
SCAN = (0.0, -2.3, -4.6, -9.2, -13.8)  # logs of common factors that a search over noise levels tries first
STATE_RANGE = 1e3  # initial states are searched within this many times their scale


@dataclass(frozen=True)
class NonlinearSetup:
    """What is searched: the problem without a gain, the method, and the noise levels known beforehand."""

    problem: TrajectoryProblem
    method: Method
    intensity: np.ndarray  # (n_w,), NaN where unknown
    estimate_intensity: np.ndarray  # (n_w,) bool
    notes: tuple[str, ...]


@dataclass(frozen=True)
class WarmStart:
    """Where a prediction-error search starts when a similar model has been fitted before: noise levels and
    the initial state of every experiment by state name. `noise_evaluations` limits the search over noise
    levels. A first pass that ends below the log-likelihood `hopeless` is the last."""

    intensity: np.ndarray  # (n_w,)
    measurement_std: np.ndarray  # (n_y,)
    initial_states: tuple[Mapping[str, float], ...]
    noise_evaluations: int = 30
    hopeless: float = -np.inf


@dataclass(frozen=True)
class Ending:
    """Where one search ended: the problem with its gain, and the noise levels behind the gain."""

    problem: TrajectoryProblem
    found: Found
    intensity: np.ndarray


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
        problem, z = _started(problem)
        problem, z = _with_hold(problem, z, options)
        _check(problem, z)
        setup = replace(setup, problem=problem)
        ends = _search(setup, z, options)
    else:
        ends = [_search_on(setup, warm, options)]
        problem = ends[0].problem
    best = ends[0]
    simulated = {"estimation": _agreement(best, problem.experiments, with_gain=False)}
    one_step = {"estimation": _agreement(best, problem.experiments, with_gain=True)}
    if validation:
        simulated["validation"] = _agreement(best, tuple(validation), with_gain=False)
        one_step["validation"] = _agreement(best, tuple(validation), with_gain=True)
    result = _result(setup, ends, simulated, one_step)
    return replace(result, seconds=time.perf_counter() - began)


def _started(problem: TrajectoryProblem) -> tuple[TrajectoryProblem, np.ndarray]:
    """State scales from a first simulation, and initial states that fit the beginning of each experiment."""
    explicit, unknowns = problem.model.explicit, problem.unknowns
    theta = problem.theta(unknowns.start)
    x0 = [initial_point(explicit, theta, e.inputs[0])[0] for e in problem.experiments]
    z = np.concatenate([unknowns.start, *x0])
    problem, z = _scaled(problem, z)
    return problem, _fit_initial_states(problem, z)


def _fit_initial_states(problem: TrajectoryProblem, z: np.ndarray) -> np.ndarray:
    """z with the initial states that fit the first samples, parameters held."""
    heads = tuple(_head(e, FIRST_LENGTH) for e in problem.experiments)
    n = len(problem.unknowns.coordinates)
    lower, upper = _limits(problem)
    lower[:n] = upper[:n] = z[:n]
    found = minimise(trajectories.objective(replace(problem, experiments=heads)), z, lower, upper, 15)
    return z if found is None else found.z


def _head(experiment: Experiment, n_samples: int) -> Experiment:
    rows = slice(0, n_samples)
    return replace(
        experiment,
        time=experiment.time[rows],
        inputs=experiment.inputs[rows],
        outputs=experiment.outputs[rows],
        extra={},
    )


def _limits(problem: TrajectoryProblem) -> tuple[np.ndarray, np.ndarray]:
    n_initial = len(problem.experiments) * problem.n_states
    lower = np.concatenate([problem.unknowns.lower, np.full(n_initial, -STATE_RANGE)])
    upper = np.concatenate([problem.unknowns.upper, np.full(n_initial, STATE_RANGE)])
    return lower, upper


def _with_hold(
    problem: TrajectoryProblem, z: np.ndarray, options: IdentifyOptions
) -> tuple[TrajectoryProblem, np.ndarray]:
    """The given hold, or the one with the higher likelihood after short fits."""
    if options.hold is not None or not problem.model.explicit.flat.inputs:
        return problem, z
    if problem.model.explicit.input_derivatives:
        return replace(problem, hold="foh"), z
    lower, upper = _limits(problem)
    best: tuple[float, Hold, np.ndarray] | None = None
    holds: tuple[Hold, Hold] = ("foh", "zoh")
    for hold in holds:
        found = minimise(
            trajectories.objective(replace(problem, hold=hold)), z, lower, upper, HOLD_ITERATIONS
        )
        if found is not None and (best is None or found.evaluation.value < best[0]):
            best = (found.evaluation.value, hold, found.z)
    return (problem, z) if best is None else (replace(problem, hold=best[1]), best[2])


def _check(problem: TrajectoryProblem, z: np.ndarray) -> None:
    start = trajectories.objective(problem)(z, True)
    if start is None:
        raise _no_start()
    assert start.information is not None
    n = len(problem.unknowns.coordinates)
    names = problem.unknowns.parameter_names()
    part = start.information[:n, :n]
    observed = sum(int(np.isfinite(e.outputs).sum()) for e in problem.experiments)
    dead = without_influence(part, observed)
    if np.any(dead):
        text = ", ".join(name for name, is_dead in zip(names, dead, strict=True) if is_dead)
        raise EstimationError(
            "identify-no-influence",
            f"no measured output depends on {text}",
            where=text,
            remedy="fix it to a known value (--fix), or measure an output that it moves",
        )
    # An unstable simulation drowns every direction but one in its growth: a short piece is asked too.
    short = replace(problem, experiments=tuple(_head(e, SHORT_LENGTH) for e in problem.experiments))
    head = trajectories.objective(short)(z, True)
    flat = flat_directions(part)
    if head is not None and head.information is not None:
        flat = flat if flat_directions(head.information[:n, :n]).shape[1] else flat[:, :0]
    if flat.shape[1]:
        direction = np.abs(flat[:, 0])
        involved = [n for n, w in zip(names, direction, strict=True) if w > 1e-3 * np.max(direction)]
        raise EstimationError(
            "identify-unidentifiable",
            f"{', '.join(involved)} can change together without any effect on the measured outputs",
            where=", ".join(involved),
            remedy="fix one of them to a known value (--fix NAME=VALUE)",
        )


def _no_start() -> EstimationError:
    return EstimationError(
        "identify-no-start",
        "the model cannot be integrated at the start values",
        remedy="check the start values of parameters and states; smooth discontinuities with a width",
    )


def _search(setup: NonlinearSetup, z: np.ndarray, options: IdentifyOptions) -> list[Ending]:
    starts = [z, *_further_starts(setup.problem, z, options)]
    ends = [end for start in starts if (end := _search_from(setup, start, options)) is not None]
    return sorted(ends, key=lambda end: end.found.evaluation.value)


def _further_starts(problem: TrajectoryProblem, z: np.ndarray, options: IdentifyOptions) -> list[np.ndarray]:
    """Parameters up to a factor 10 off (linear ones by 3 scales); initial states refitted."""
    rng = np.random.default_rng(options.seed)
    lower, upper = _limits(problem)
    spread = np.array([np.log(10.0) if c.is_log else 3.0 for c in problem.unknowns.coordinates])
    result = []
    for _ in range(options.starts - 1):
        moved = z.copy()
        moved[: spread.size] += rng.uniform(-spread, spread)
        result.append(_fit_initial_states(problem, np.clip(moved, lower, upper)))
    return result


def _search_from(setup: NonlinearSetup, z: np.ndarray, options: IdentifyOptions) -> Ending | None:
    problem = setup.problem
    lower, upper = _limits(problem)
    found = minimise(trajectories.objective(problem), z, lower, upper, options.max_iterations)
    if found is None or setup.method == "oe":
        return None if found is None else Ending(problem, found, setup.intensity)
    intensity = setup.intensity
    for _ in range(NOISE_ROUNDS):
        problem, intensity = _with_gain(setup, found.z, intensity)
        again = minimise(trajectories.objective(problem), found.z, lower, upper, options.max_iterations)
        found = again or found
    return Ending(problem, found, intensity)


def _search_on(setup: NonlinearSetup, warm: WarmStart, options: IdentifyOptions) -> Ending:
    """Prediction-error search from the noise levels and initial states of a similar model.

    What the similar model called noise may now be explained, so that the search starts both from its noise
    levels and from next to none, and goes on from the better end: noise levels and parameters in turn.
    """
    problem = setup.problem
    names = problem.model.explicit.state_names
    x0 = [np.array([state.get(name, 0.0) for name in names]) for state in warm.initial_states]
    problem, z = _scaled(problem, np.concatenate([problem.unknowns.start, *x0]))
    problem = replace(problem, rtol=WARM_RTOL)
    ends = []
    for share in (1.0, NEARLY_NONE):
        levels = np.where(setup.estimate_intensity, share * warm.intensity, warm.intensity)
        end = _search_at(setup, replace(problem, gain=None), z, levels, warm.measurement_std)
        ends += [] if end is None else [end]
    if not ends:
        raise _no_start()
    best = min((_rescanned(setup, end, warm) for end in ends), key=lambda e: e.found.evaluation.value)
    for _ in range(WARM_ROUNDS if -best.found.evaluation.value > warm.hopeless else 0):
        around = replace(setup, problem=best.problem)
        start = (best.intensity, warm.measurement_std)
        gained, levels = _with_gain(around, best.found.z, warm.intensity, start, warm.noise_evaluations)
        lower, upper = _limits(gained)
        found = minimise(
            trajectories.objective(gained), best.found.z, lower, upper, options.max_iterations, WARM_GAIN
        )
        if found is None or best.found.evaluation.value - found.evaluation.value < 0.0:
            break
        improved = best.found.evaluation.value - found.evaluation.value
        best = Ending(gained, found, levels)
        if improved < ENOUGH_GAIN:
            break
    return best


def _rescanned(setup: NonlinearSetup, end: Ending, warm: WarmStart) -> Ending:
    """The end with the best of a few noise levels: what its parameters are worth shows only with the noise
    that they leave, not with the noise that they were found under."""
    start = (warm.intensity, warm.measurement_std)
    around = replace(setup, problem=end.problem)
    problem, levels = _with_gain(around, end.found.z, warm.intensity, start, evaluations=0)
    errors = prediction_errors(problem, end.found.z)
    if errors is None or errors.negative_log_likelihood >= end.found.evaluation.value:
        return end
    evaluation = replace(end.found.evaluation, value=errors.negative_log_likelihood)
    return Ending(problem, replace(end.found, evaluation=evaluation), levels)


def _search_at(
    setup: NonlinearSetup,
    problem: TrajectoryProblem,
    z: np.ndarray,
    intensity: np.ndarray,
    std: np.ndarray,
) -> Ending | None:
    """Rough search of the parameters with the gain of given noise levels."""
    found_gain = observer(_average(problem, z), intensity, std) if _runs(problem, z) else None
    gained = replace(problem, gain=None if found_gain is None else found_gain.gain)
    lower, upper = _limits(gained)
    found = minimise(trajectories.objective(gained), z, lower, upper, ROUGH_ITERATIONS, ROUGH_GAIN)
    return None if found is None else Ending(gained, found, intensity)


def _runs(problem: TrajectoryProblem, z: np.ndarray) -> bool:
    return prediction_errors(problem, z) is not None


def _scaled(problem: TrajectoryProblem, z: np.ndarray) -> tuple[TrajectoryProblem, np.ndarray]:
    """The problem with state scales read off a simulation, and z (given unscaled) in them."""
    n = len(problem.unknowns.coordinates)
    errors = prediction_errors(problem, z)
    if errors is None:
        return problem, z
    size = np.max([np.max(np.abs(t.states), axis=0) for t in errors.trajectories], axis=0)
    scale = np.where(np.isfinite(size) & (size > 0.0), size, 1.0)
    x0 = z[n:].reshape(-1, scale.size) / scale
    return replace(problem, state_scale=scale), np.concatenate([z[:n], x0.ravel()])


def _with_gain(
    setup: NonlinearSetup,
    z: np.ndarray,
    intensity: np.ndarray,
    around: tuple[np.ndarray, np.ndarray] | None = None,
    evaluations: int = NOISE_EVALUATIONS,
) -> tuple[TrajectoryProblem, np.ndarray]:
    """The problem with the gain of the most likely noise levels at the parameters z.

    Only the ratios of process to measurement noise matter for the gain, so the standard deviation of the
    first output is left out of the search and follows from the innovations. `around` are (intensity, std) to
    start from.
    """
    problem = setup.problem
    average = _average(problem, z)
    if around is None:
        rough = _rough_std(problem, z)
        start = np.where(np.isnan(intensity), _unit_intensity(average, rough), intensity)
    else:
        start, rough = around
    searched = np.flatnonzero(setup.estimate_intensity)

    def levels(logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q, std = start.copy(), rough.copy()
        q[searched] = start[searched] * np.exp(logs[: searched.size])
        std[1:] = rough[1:] * np.exp(logs[searched.size :])
        return q, std

    def value(logs: np.ndarray) -> float:
        found = observer(average, *levels(logs))
        if found is None:
            return np.inf
        errors = prediction_errors(replace(problem, gain=found.gain), z)
        return np.inf if errors is None else errors.negative_log_likelihood

    n = searched.size + rough.size - 1
    best = np.zeros(n)
    if n:
        scanned = [np.concatenate([np.full(searched.size, s), np.zeros(n - searched.size)]) for s in SCAN]
        best = min(scanned, key=value)
        simplex = np.vstack(
            [best, best - NOISE_SPREAD * np.diag([1.0] * searched.size + [0.1] * (n - searched.size))]
        )
        options = {"maxfev": evaluations, "initial_simplex": simplex, "xatol": 0.05, "fatol": 0.1}
        if evaluations:
            best = minimize(value, best, method="Nelder-Mead", options=options).x
    q, std = levels(best)
    found = observer(average, q, std)
    if found is None:
        return problem, intensity
    gained = replace(problem, gain=found.gain)
    errors = prediction_errors(gained, z)
    if errors is None:
        return problem, intensity
    # The innovations tell the common size of all noises.
    size = np.mean(np.diagonal(errors.covariance) / np.diagonal(found.innovation_cov))
    return gained, np.where(setup.estimate_intensity, q * size, q)


def _average(problem: TrajectoryProblem, z: np.ndarray) -> AverageModel:
    longest = int(np.argmax([e.n_samples for e in problem.experiments]))
    experiment = problem.experiments[longest]
    errors = prediction_errors(problem, z)
    assert errors is not None
    u0, _ = interval_inputs(problem.model.explicit, experiment.time, experiment.inputs, problem.hold)
    ubar = np.vstack([u0, u0[-1:]])
    states = errors.trajectories[longest].states
    return average_model(problem.model.explicit, problem.theta(z), experiment.time, states, ubar)


def _rough_std(problem: TrajectoryProblem, z: np.ndarray) -> np.ndarray:
    """The white part of the simulation errors, from second differences."""
    errors = prediction_errors(problem, z)
    assert errors is not None
    second = np.concatenate([np.diff(e, 2, axis=0) for e in errors.errors])
    fine = np.sqrt(np.nanmean(second**2, axis=0) / 6.0)
    whole = np.sqrt(np.diagonal(errors.covariance))
    return np.where(np.isfinite(fine) & (fine > 0.0), np.minimum(fine, whole), whole)


def _unit_intensity(average: AverageModel, std: np.ndarray) -> np.ndarray:
    """Intensity of each noise that moves the outputs in one period by about their measurement noise."""
    step = np.abs(average.C @ average.G) * np.sqrt(average.period)
    two_steps = np.abs(average.C @ average.A @ average.G) * average.period**1.5
    reach = np.maximum(step, two_steps) / std[:, None]
    largest = reach.max(axis=0, initial=0.0)
    return 1.0 / np.where(largest > 0.0, largest, 1.0) ** 2


def _agreement(end: Ending, experiments: tuple[Experiment, ...], *, with_gain: bool) -> Agreement:
    """Agreement from the best initial state of each experiment, parameters held."""
    problem = end.problem if with_gain else replace(end.problem, gain=None)
    n = len(problem.unknowns.coordinates)
    names = [o.name for o in problem.model.explicit.flat.outputs]
    parameters = end.found.z[:n]
    problem = replace(problem, experiments=experiments)
    theta = problem.theta(parameters)
    x0 = [
        initial_point(problem.model.explicit, theta, e.inputs[0])[0] / problem.state_scale
        for e in experiments
    ]
    z = np.concatenate([parameters, *x0])
    z = end.found.z if experiments is end.problem.experiments else _fit_initial_states(problem, z)
    lower, upper = _limits(problem)
    lower[:n] = upper[:n] = parameters
    found = minimise(trajectories.objective(problem), z, lower, upper, 10)
    errors = None if found is None else prediction_errors(problem, found.z)
    fits: dict[str, float | None] = dict.fromkeys(names)
    rms: dict[str, float | None] = dict.fromkeys(names)
    if errors is not None:
        for j, name in enumerate(names):
            fits[name], rms[name] = _output_agreement(
                [e.outputs[:, j] for e in experiments], [e[:, j] for e in errors.errors]
            )
    return Agreement(fits, rms)


def _output_agreement(
    measured: list[np.ndarray], errors: list[np.ndarray]
) -> tuple[float | None, float | None]:
    left = np.concatenate([e[np.isfinite(e)] for e in errors])
    seen = [m[np.isfinite(m)] for m in measured]
    if not left.size:
        return None, None
    spread = sum(float(np.sum((m - m.mean()) ** 2)) for m in seen if m.size)
    fit = float(100.0 * (1.0 - np.sqrt(np.sum(left**2) / spread))) if spread > 0.0 else None
    return fit, float(np.sqrt(np.mean(left**2)))


def _result(
    setup: NonlinearSetup,
    ends: list[Ending],
    simulated: dict[str, Agreement],
    one_step: dict[str, Agreement],
) -> FitResult:
    end = ends[0]
    problem, unknowns, found = end.problem, end.problem.unknowns, end.found
    n = len(unknowns.coordinates)
    explicit = problem.model.explicit
    errors = prediction_errors(problem, found.z, with_slopes=True)
    assert errors is not None
    parts = _scores(problem, errors, found.z)
    slopes = unknowns.slopes(found.z[:n])
    bounds = [bound_of(c, z) for c, z in zip(unknowns.coordinates, found.z[:n], strict=True)]
    information = np.sum([np.tensordot(s.slopes, s.slopes, ((1, 2), (1, 2))) for s in parts], axis=0)
    observed = [np.isfinite(e.outputs) for e in problem.experiments]
    count = sum(int(o.sum()) for o in observed)
    in_z = information * np.outer(slopes, slopes)
    free = ~without_influence(in_z, count) & np.array([b is None for b in bounds], dtype=bool)
    notes = list(setup.notes)
    if setup.method == "oe":
        uncertain = output_error_covariance(parts, observed, slopes, free)
        cov_z = uncertain.covariance
        if uncertain.is_coloured:
            notes.append("the simulation residuals are not white; the standard errors account for that")
    else:
        cov_z = covariance(in_z, free)
    cov = cov_z * np.outer(slopes, slopes)
    values = unknowns.natural(found.z[:n])
    std_errors = [float(np.sqrt(v)) if np.isfinite(v) and v >= 0.0 else None for v in np.diagonal(cov)]
    weak = weak_directions(unknowns.coordinates, values, information, cov)
    initial = {c.name: c.initial for c in unknowns.coordinates}
    parameters = tuple(
        _fitted_parameter(explicit, c, v, s, b, initial[c.name])
        for c, v, s, b in zip(unknowns.coordinates, values, std_errors, bounds, strict=True)
    )
    noises = _noises(setup, end, errors.covariance, count)
    periods = {e.period for e in problem.experiments}
    theta = problem.theta(found.z)
    return FitResult(
        status=found.reason,
        message=message_of(found, parameters, noises, weak, [e.found for e in ends]),
        method=setup.method,
        parameters=parameters,
        theta={p.name: float(v) for p, v in zip(explicit.flat.parameters, theta, strict=True)},
        noises=noises,
        noise_model="white",
        initial_states=_initial_states(problem, parts, found.z, cov),
        correlation_names=tuple(c.name for c in unknowns.coordinates),
        correlation=correlation(cov),
        weak_directions=weak,
        weak_threshold=WEAK_RELATIVE_STD,
        log_likelihood=-found.evaluation.value,
        start_log_likelihoods=tuple(-e.found.evaluation.value for e in ends),
        simulated=simulated,
        one_step=one_step,
        n_samples=sum(e.n_samples for e in problem.experiments),
        n_iterations=found.iterations,
        seconds=0.0,
        period=periods.pop() if len(periods) == 1 else None,
        hold=problem.hold,
        notes=tuple(notes),
    )


def _scores(problem: TrajectoryProblem, errors: trajectories.Errors, z: np.ndarray) -> list[Scores]:
    """Whitened residuals with slopes per unit of the parameters, initial states projected out."""
    n = len(problem.unknowns.coordinates)
    root = np.linalg.inv(np.linalg.cholesky(errors.covariance)).T
    parts = []
    for error, trajectory in zip(errors.errors, errors.trajectories, strict=True):
        observed = np.isfinite(error)
        change = np.where(observed, -trajectory.sensitivities.transpose(2, 0, 1), 0.0) @ root
        residuals = np.where(observed, error, 0.0) @ root
        parts.append(scores(residuals, -change[n:], change[:n]))
    return parts


def _fitted_parameter(
    explicit: ExplicitModel,
    coordinate: Coordinate,
    value: float,
    std_error: float | None,
    bound: object,
    initial: float,
) -> FittedParameter:
    return FittedParameter(
        name=coordinate.name,
        value=float(value),
        std_error=std_error,
        initial=initial,
        unit=explicit.flat.parameters[coordinate.index].unit,
        min=None if np.isinf(coordinate.lower) else coordinate.lower,
        max=None if np.isinf(coordinate.upper) else coordinate.upper,
        at_bound=bound,  # type: ignore[arg-type]
    )


def _noises(
    setup: NonlinearSetup, end: Ending, innovation_cov: np.ndarray, count: int
) -> tuple[FittedNoise, ...]:
    flat = end.problem.model.explicit.flat
    result = []
    std = np.sqrt(np.diagonal(innovation_cov))
    if setup.method == "pem":
        result += [
            FittedNoise(w.name, "process", float(q), None, w.unit, bool(estimated), None)
            for w, q, estimated in zip(flat.noises, end.intensity, setup.estimate_intensity, strict=True)
            if np.isfinite(q)
        ]
        found = observer(_average(end.problem, end.found.z), np.nan_to_num(end.intensity), std)
        if found is not None:
            # cov(ν) = C P Cᵀ + R: what the state's uncertainty adds is no measurement noise.
            share = np.clip(std**2 / np.diagonal(found.innovation_cov), 0.0, 1.0)
            std = std * np.sqrt(share)
    per_output = max(count / max(std.size, 1), 1.0)
    result += [
        FittedNoise(
            o.name,
            "measurement",
            float(s),
            float(s / np.sqrt(2.0 * per_output)),
            o.unit,
            bool(np.isnan(given)),
            None,
        )
        for o, s, given in zip(flat.outputs, std, setup.problem.given_std, strict=True)
    ]
    return tuple(result)


def _initial_states(
    problem: TrajectoryProblem, parts: list[Scores], z: np.ndarray, cov: np.ndarray
) -> tuple[FittedInitialState, ...]:
    names = problem.model.explicit.state_names
    result = []
    for experiment, part, x0 in zip(problem.experiments, parts, problem.initial_states(z), strict=True):
        spread = part.initial_slope @ np.nan_to_num(cov) @ part.initial_slope.T
        with np.errstate(invalid="ignore"):
            std = np.sqrt(np.diagonal(part.initial_cov) + np.diagonal(spread))
        result.append(FittedInitialState(experiment.name, names, x0, std))
    return tuple(result)
