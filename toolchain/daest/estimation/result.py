"""From the end of a search to a FitResult: estimates, uncertainty, verdict.

Agreement of a fitted model with recordings: simulation from the best initial state, and one-step
prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from daest.estimation.coordinates import Coordinate, Unknowns, log_likelihood, prior_precisions
from daest.estimation.gates import FIT
from daest.estimation.identifiability import (
    ROUNDING,
    Scores,
    Uncertainty,
    correlation,
    covariance,
    output_error_covariance,
    std_errors,
    weak_directions,
    without_influence,
)
from daest.estimation.linear_predictors import Predicted, Problem, all_scores, predict, simulate
from daest.estimation.records import Record, observed_counts
from daest.estimation.search import Found
from daest.estimation.stationary import unseen_directions, unseen_note
from daest.model.fit import (
    Agreement,
    Bound,
    FitResult,
    FittedInitialState,
    FittedNoise,
    FittedParameter,
    Method,
    WeakDirection,
)
from daest.model.parts import Parameter
from daest.systems.state_space import state_space

COLOURED = "the simulation residuals are not white; the standard errors account for that"


class Recorded(Protocol):
    """A recording, or what was prepared from it."""

    @property
    def period(self) -> float | None: ...


@dataclass(frozen=True)
class End:
    """The best point of a search in the units of its p unknowns: `information` (p, p) is that of the search,
    per unit of its coordinates."""

    unknowns: Unknowns
    values: np.ndarray  # (p,)
    cov: np.ndarray  # (p, p), NaN where not determined
    errors: Sequence[float | None]
    bounds: Sequence[Bound | None]
    information: np.ndarray


@dataclass(frozen=True)
class Told:
    """What a predictor tells of the end of its search besides the unknowns; theta (n_parameters,) are all
    parameters of the model, fields as in `FitResult`."""

    method: Method
    theta: np.ndarray
    noises: tuple[FittedNoise, ...]
    noise_model: Literal["white", "held"]
    initial_states: tuple[FittedInitialState, ...]
    simulated: dict[str, Agreement]
    one_step: dict[str, Agreement]
    n_samples: int
    hold: Literal["foh", "zoh"]
    notes: tuple[str, ...]
    unseen: tuple[str, ...]


@dataclass(frozen=True)
class _Judged:
    """The end of a linear search with its scores, initial states and measurement noise (n_y,)."""

    end: End
    parts: list[Scores]
    initial_states: tuple[np.ndarray, ...]
    measurement_std: np.ndarray
    is_coloured: bool


def fit_result(
    problem: Problem,
    method: Method,
    ends: list[Found],
    measurement: dict[int, bool],
    simulated: dict[str, Agreement],
    one_step: dict[str, Agreement],
    notes: tuple[str, ...],
) -> FitResult:
    """FitResult of the best search (`ends[0]`); `seconds` and the initial values are left to the caller."""
    best, family = ends[0], problem.family
    judged = _judge(problem, best)
    theta, intensity, _ = problem.unknowns.values(best.z)
    noises = _process_noises(problem, intensity, judged) if problem.is_filtered else ()
    noises += _measurement_noises(problem, measurement, judged)
    if judged.is_coloured:
        notes = (*notes, COLOURED)
    initial = tuple(
        fitted_initial_state(record.name, family.state_names, x0, part, judged.end.cov)
        for record, x0, part in zip(problem.records, judged.initial_states, judged.parts, strict=True)
    )
    told = Told(
        method=method,
        theta=theta,
        noises=noises,
        noise_model=problem.sampled,
        initial_states=initial,
        simulated=simulated,
        one_step=one_step,
        n_samples=sum(int(r.recorded.size) for r in problem.records),
        hold=problem.hold,
        notes=notes,
        unseen=_unseen(problem, theta),
    )
    return assembled(judged.end, ends, family.parameters, problem.records, told)


def assembled(
    end: End,
    ends: Sequence[Found],
    model: Sequence[Parameter],
    experiments: Sequence[Recorded],
    told: Told,
) -> FitResult:
    """The result of a search, whatever its predictor was: `end` is its best point, `ends` where the searches
    from all start points ended, `model` the parameters of the model, in order. `seconds` is left to the
    caller."""
    best, unknowns = ends[0], end.unknowns
    own = unknowns.of_kind("parameter")
    parameters = tuple(
        fitted_parameter(unknowns.coordinates[i], model, end.values[i], end.errors[i], end.bounds[i])
        for i in own
    )
    rows = np.ix_(own, own)
    slopes = unknowns.slopes(best.z[: len(unknowns.coordinates)])[own]
    information = end.information[rows] / np.outer(slopes, slopes)
    coordinates = tuple(unknowns.coordinates[i] for i in own)
    weak = weak_directions(coordinates, end.values[own], information, end.cov[rows])
    periods = {e.period for e in experiments}
    return FitResult(
        status=best.reason,
        message=message_of(best, parameters, told.noises, weak, list(ends)),
        method=told.method,
        parameters=parameters,
        theta={p.name: float(v) for p, v in zip(model, told.theta, strict=True)},
        noises=told.noises,
        noise_model=told.noise_model,
        initial_states=told.initial_states,
        correlation_names=tuple(c.name for c in unknowns.coordinates),
        correlation=correlation(end.cov),
        weak_directions=weak,
        weak_threshold=FIT.weak_direction,
        log_likelihood=log_likelihood(unknowns, best),
        start_log_likelihoods=tuple(log_likelihood(unknowns, one) for one in ends),
        simulated=told.simulated,
        one_step=told.one_step,
        n_samples=told.n_samples,
        n_iterations=best.iterations,
        seconds=0.0,
        period=periods.pop() if len(periods) == 1 else None,
        hold=told.hold,
        notes=(*told.notes, *unseen_note(told.unseen)),
        unseen_states=told.unseen,
    )


def fitted_parameter(
    coordinate: Coordinate,
    model: Sequence[Parameter],
    value: float,
    std_error: float | None,
    bound: Bound | None,
) -> FittedParameter:
    """The estimate of one parameter, in its own unit."""
    return FittedParameter(
        name=coordinate.name,
        value=float(value),
        std_error=std_error,
        initial=coordinate.initial,
        unit=model[coordinate.index].unit,
        min=None if np.isinf(coordinate.lower) else coordinate.lower,
        max=None if np.isinf(coordinate.upper) else coordinate.upper,
        at_bound=bound,
        prior=coordinate.prior,
    )


def fitted_initial_state(
    name: str, names: tuple[str, ...], x0: np.ndarray, part: Scores, cov: np.ndarray
) -> FittedInitialState:
    """The initial state of one recording, with what the covariance `cov` of the unknowns adds to its own."""
    spread = part.initial_slope @ np.nan_to_num(cov) @ part.initial_slope.T
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.diagonal(part.initial_cov) + np.diagonal(spread))
    return FittedInitialState(name, names, x0, errors)


def _unseen(problem: Problem, theta: np.ndarray) -> tuple[str, ...]:
    ss, steps = state_space(problem.family, theta), np.diff(problem.records[0].time)
    return unseen_directions(ss.A, ss.C, float(np.median(steps)), problem.family.state_names)


def _judge(problem: Problem, best: Found) -> _Judged:
    """Bounds first: an unknown that rests at one is left out of the covariance of the others."""
    unknowns = problem.unknowns
    parts, predicted = end_scores(problem, best.z)
    bounds = [bound_of(c, z) for c, z in zip(unknowns.coordinates, best.z, strict=True)]
    variances = np.diagonal(_uncertainty(problem, best, parts, bounds).covariance)
    bounds = [
        bound or _open_bound(c, z, variance)
        for c, bound, z, variance in zip(unknowns.coordinates, bounds, best.z, variances, strict=True)
    ]
    in_z = _uncertainty(problem, best, parts, bounds)
    slopes = unknowns.slopes(best.z)
    cov = in_z.covariance * np.outer(slopes, slopes)
    values = unknowns.natural(best.z)
    end = End(unknowns, values, cov, std_errors(cov, values), bounds, best.evaluation.information)
    return _Judged(end, parts, predicted.initial_states, predicted.measurement_std, in_z.is_coloured)


def end_scores(problem: Problem, z: np.ndarray) -> tuple[list[Scores], Predicted]:
    """Scores of all records at the end of a search, and the predictions that they belong to."""
    predicted = problem.predict(z, with_slopes=True)
    assert predicted is not None
    return all_scores(predicted), predicted


def _uncertainty(
    problem: Problem, best: Found, parts: list[Scores], bounds: list[Bound | None]
) -> Uncertainty:
    """Covariance in z over the unknowns that are off their bounds and have an influence."""
    information = best.evaluation.information
    n_observed = int(observed_counts(problem.records).sum())
    free = ~without_influence(information, n_observed) & np.array([b is None for b in bounds], dtype=bool)
    if problem.is_filtered:
        return Uncertainty(covariance(information, free), False)
    observed = [r.observed for r in problem.records]
    precision = prior_precisions(problem.unknowns)
    return output_error_covariance(parts, observed, problem.unknowns.slopes(best.z), free, precision)


def bound_of(coordinate: Coordinate, z: float) -> Bound | None:
    """The bound that z rests at."""
    if z <= coordinate.searched(coordinate.lower) + FIT.at_bound:
        return "min"
    if z >= coordinate.searched(coordinate.upper) - FIT.at_bound:
        return "max"
    return None


def _open_bound(coordinate: Coordinate, z: float, variance_z: float) -> Bound | None:
    """A logarithmic unknown whose likelihood does not fall towards zero counts as being at zero."""
    if not coordinate.is_log or (coordinate.kind == "parameter" and coordinate.lower > 0.0):
        return None
    unsure = not np.isfinite(variance_z) or variance_z > FIT.open_towards_zero**2
    fell = coordinate.kind != "parameter" or z < coordinate.searched(coordinate.initial)
    return "min" if unsure and fell else None


def _searched(problem: Problem, kind: str) -> dict[int, int]:
    """Noise or output index -> position among the unknowns."""
    return {problem.unknowns.coordinates[i].index: i for i in problem.unknowns.of_kind(kind)}


def _process_noises(problem: Problem, intensity: np.ndarray, judged: _Judged) -> tuple[FittedNoise, ...]:
    searched, result = _searched(problem, "process"), []
    for k, noise in enumerate(problem.family.noises):
        i = searched.get(k)
        error, bound = (None, None) if i is None else (judged.end.errors[i], judged.end.bounds[i])
        value = float(intensity[k])
        result.append(FittedNoise(noise.name, "process", value, error, noise.unit, i is not None, bound))
    return tuple(result)


def _measurement_noises(
    problem: Problem, measurement: dict[int, bool], judged: _Judged
) -> tuple[FittedNoise, ...]:
    """Noises of the measured outputs. One that was eliminated is a mean of n squares: std(σ) = σ / √(2 n)."""
    searched, result = _searched(problem, "measurement"), []
    counts = observed_counts(problem.records)
    for j in np.flatnonzero(counts):
        output, value, i = problem.family.outputs[j], float(judged.measurement_std[j]), searched.get(int(j))
        estimated = measurement[int(j)]
        error = value / float(np.sqrt(2.0 * counts[j])) if estimated else None
        bound = None
        if i is not None:
            error, bound = judged.end.errors[i], judged.end.bounds[i]
        result.append(FittedNoise(output.name, "measurement", value, error, output.unit, estimated, bound))
    return tuple(result)


def message_of(
    best: Found,
    parameters: tuple[FittedParameter, ...],
    noises: tuple[FittedNoise, ...],
    weak: tuple[WeakDirection, ...],
    ends: list[Found],
) -> str:
    """What happened and what to try, in sentences."""
    said = [_ending(best)]
    if len(ends) > 1:
        same = sum(end.evaluation.value - best.evaluation.value < FIT.same_optimum for end in ends)
        said.append(f"{same} of {len(ends)} starts reached this likelihood.")
    at_bound = [f"{p.name} ({p.at_bound})" for p in parameters if p.at_bound]
    if at_bound:
        said.append(f"At a bound: {', '.join(at_bound)}; widen the bound or look for what drives it there.")
    unknown = [p.name for p in parameters if p.std_error is None and not p.at_bound]
    if unknown:
        said.append(f"The data do not determine {', '.join(unknown)}: fix it, or measure more.")
    exact = [p.name for p in parameters if p.std_error and p.std_error <= 1.01 * ROUNDING * abs(p.value)]
    if exact:
        said.append(
            f"The standard errors of {', '.join(exact)} are at the rounding of numbers: the data have no "
            "noise, or the simulation is too unstable for them to mean anything."
        )
    if weak:
        said += [_weak_text(direction) for direction in weak]
    absent = [f"{n.kind} noise at {n.name}" for n in noises if n.at_bound == "min"]
    if absent:
        said.append(f"The data ask for no {', no '.join(absent)}.")
    return " ".join(said)


def _weak_text(direction: WeakDirection) -> str:
    """One weak direction in words."""
    names, weights = list(direction.combination), set(direction.combination.values())
    percent = 100.0 * direction.relative_std
    size = "not known at all" if np.isinf(percent) else f"± {percent:.{2 if percent < 100.0 else 3}g} %"
    if len(names) == 1:
        return f"{names[0]} is hardly known ({size})."
    listed = ", ".join(names[:-1]) + " and " + names[-1]
    if weights == {1.0}:
        return f"{listed} are known only up to a common factor ({size}); fix one of them from another source."
    powers = " · ".join(f"{n}^{w:g}" for n, w in direction.combination.items())
    return f"{listed} can move together as {powers} ({size}); fix one of them from another source."


def _ending(best: Found) -> str:
    if best.reason == "converged":
        # None: what came before the search proper was the best already.
        return f"Converged after {best.iterations} iterations." if best.iterations else "Converged."
    if best.reason == "stalled":
        return (
            f"No better point was found after {best.iterations} iterations, although a gain of "
            f"{best.predicted_gain:.2g} was expected: try other start values (--starts 5)."
        )
    return f"Stopped after {best.iterations} iterations without converging: allow more, or start elsewhere."


def simulated_agreement(problem: Problem, records: tuple[Record, ...], z: np.ndarray) -> Agreement:
    """Error of the simulation; the initial state of every record is the one that fits the record best."""
    theta, _, std = problem.unknowns.values(z)
    return _agreement(problem, records, simulate(replace(problem, records=records), theta, std))


def predicted_agreement(problem: Problem, records: tuple[Record, ...], z: np.ndarray) -> Agreement:
    """Error of the one-step prediction by the Kalman filter of `problem`."""
    return _agreement(problem, records, predict(replace(problem, records=records), z))


def _agreement(problem: Problem, records: tuple[Record, ...], predicted: Predicted | None) -> Agreement:
    fits: dict[str, float | None] = {}
    rms: dict[str, float | None] = {}
    for j, output in enumerate(problem.family.outputs):
        fits[output.name], rms[output.name] = None, None
        count = sum(int(r.n_observed[j]) for r in records)
        if predicted is None or count == 0:
            continue
        error = spread = 0.0
        for record, residuals, x0 in zip(records, predicted.found, predicted.initial_states, strict=True):
            left = residuals.at_zero[:, j] - x0 @ residuals.response[:, :, j]
            measured = record.outputs[record.observed[:, j], j]
            error += float(left @ left)
            spread += float(np.sum((measured - measured.mean()) ** 2)) if measured.size else 0.0
        rms[output.name] = float(np.sqrt(error / count))
        fits[output.name] = float(100.0 * (1.0 - np.sqrt(error / spread))) if spread > 0.0 else None
    return Agreement(fits, rms)


def agreement_of(
    names: Sequence[str], measured: Sequence[np.ndarray], errors: Sequence[np.ndarray] | None
) -> Agreement:
    """Agreement from the errors of all experiments (n_samples, n_y), NaN where missing; None: no errors."""
    fits: dict[str, float | None] = dict.fromkeys(names)
    rms: dict[str, float | None] = dict.fromkeys(names)
    for j, name in enumerate(names if errors is not None else ()):
        assert errors is not None
        left = np.concatenate([e[np.isfinite(e[:, j]), j] for e in errors])
        seen = [m[np.isfinite(m[:, j]), j] for m in measured]
        spread = sum(float(np.sum((m - m.mean()) ** 2)) for m in seen if m.size)
        if left.size:
            rms[name] = float(np.sqrt(np.mean(left**2)))
            fits[name] = float(100.0 * (1.0 - np.sqrt(np.sum(left**2) / spread))) if spread > 0.0 else None
    return Agreement(fits, rms)
