"""From the end of a search to a FitResult: estimates, uncertainty, verdict."""

from __future__ import annotations

import numpy as np

from daest.estimation import likelihood, output_error
from daest.estimation.coordinates import Coordinate
from daest.estimation.identifiability import (
    WEAK_RELATIVE_STD,
    Uncertainty,
    correlation,
    covariance,
    output_error_covariance,
    weak_directions,
    without_influence,
)
from daest.estimation.output_error import Problem
from daest.estimation.records import observed_counts
from daest.estimation.scores import Scores
from daest.estimation.search import Found
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

AT_BOUND = 1e-6  # distance in z within which an unknown lies at its bound
OPEN_TOWARDS_ZERO = 5.0  # standard deviation of log(value) above which a value may as well be zero


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
    best, unknowns = ends[0], problem.unknowns
    coordinates, values = unknowns.coordinates, unknowns.natural(best.z)
    parts, states, std = end_scores(problem, method, best.z)
    bounds = [bound_of(c, z) for c, z in zip(coordinates, best.z, strict=True)]
    in_z = _uncertainty(problem, method, best, parts, bounds)
    bounds = [
        bound or _open_bound(c, z, variance)
        for c, bound, z, variance in zip(
            coordinates, bounds, best.z, np.diagonal(in_z.covariance), strict=True
        )
    ]
    in_z = _uncertainty(problem, method, best, parts, bounds)
    slopes = unknowns.slopes(best.z)
    cov = in_z.covariance * np.outer(slopes, slopes)
    errors = _std_errors(cov)
    theta, intensity, _ = unknowns.values(best.z)
    family = problem.family
    which = unknowns.of_kind("parameter")
    information = best.evaluation.information[np.ix_(which, which)] / np.outer(slopes[which], slopes[which])
    weak = weak_directions(
        tuple(coordinates[i] for i in which), values[which], information, cov[np.ix_(which, which)]
    )
    parameters = tuple(
        _parameter(family.parameters[coordinates[i].index], coordinates[i], values[i], errors[i], bounds[i])
        for i in which
    )
    if in_z.is_coloured:
        notes = (*notes, "the simulation residuals are not white; the standard errors account for that")
    noises = _noises(problem, method, measurement, intensity, std, coordinates, errors, bounds)
    initial = tuple(
        _initial_state(record.name, family.state_names, x0, part, cov)
        for record, x0, part in zip(problem.records, states, parts, strict=True)
    )
    periods = {r.period for r in problem.records}
    return FitResult(
        status=best.reason,
        message=message_of(best, parameters, noises, weak, ends),
        method=method,
        parameters=parameters,
        theta={p.name: float(v) for p, v in zip(family.parameters, theta, strict=True)},
        noises=noises,
        noise_model="held" if problem.sampled == "held" else "white",
        initial_states=initial,
        correlation_names=tuple(c.name for c in coordinates),
        correlation=correlation(cov),
        weak_directions=weak,
        weak_threshold=WEAK_RELATIVE_STD,
        log_likelihood=-best.evaluation.value,
        start_log_likelihoods=tuple(-end.evaluation.value for end in ends),
        simulated=simulated,
        one_step=one_step,
        n_samples=sum(int(r.recorded.size) for r in problem.records),
        n_iterations=best.iterations,
        seconds=0.0,
        period=periods.pop() if len(periods) == 1 else None,
        hold=problem.hold,
        notes=notes,
    )


def end_scores(
    problem: Problem, method: Method, z: np.ndarray
) -> tuple[list[Scores], tuple[np.ndarray, ...], np.ndarray]:
    """Scores of all records, the initial states, and the measurement std (n_y,)."""
    if method == "pem":
        predicted = likelihood.predict(problem, z, with_slopes=True)
        assert predicted is not None
        return (
            likelihood.all_scores(problem, predicted),
            predicted.initial_states,
            problem.unknowns.values(z)[2],
        )
    theta, _, std = problem.unknowns.values(z)
    simulated = output_error.simulate(problem, theta, std, with_slopes=True)
    assert simulated is not None
    return output_error.all_scores(problem, simulated), simulated.initial_states, simulated.measurement_std


def _uncertainty(
    problem: Problem, method: Method, best: Found, parts: list[Scores], bounds: list[Bound | None]
) -> Uncertainty:
    """Covariance in z over the unknowns that are off their bounds and have an influence."""
    information = best.evaluation.information
    n_observed = int(observed_counts(problem.records).sum())
    free = ~without_influence(information, n_observed) & np.array([b is None for b in bounds], dtype=bool)
    if method == "pem":
        return Uncertainty(covariance(information, free), False)
    observed = [r.observed for r in problem.records]
    return output_error_covariance(parts, observed, problem.unknowns.slopes(best.z), free)


def bound_of(coordinate: Coordinate, z: float) -> Bound | None:
    """The bound that z rests at."""
    if z <= coordinate.searched(coordinate.lower) + AT_BOUND:
        return "min"
    if z >= coordinate.searched(coordinate.upper) - AT_BOUND:
        return "max"
    return None


def _open_bound(coordinate: Coordinate, z: float, variance_z: float) -> Bound | None:
    """A logarithmic unknown whose likelihood does not fall towards zero counts as being at zero."""
    if not coordinate.is_log or (coordinate.kind == "parameter" and coordinate.lower > 0.0):
        return None
    unsure = not np.isfinite(variance_z) or variance_z > OPEN_TOWARDS_ZERO**2
    fell = coordinate.kind != "parameter" or z < coordinate.searched(coordinate.initial)
    return "min" if unsure and fell else None


def _std_errors(cov: np.ndarray) -> list[float | None]:
    return [float(np.sqrt(v)) if np.isfinite(v) and v >= 0.0 else None for v in np.diagonal(cov)]


def _parameter(
    parameter: object, coordinate: Coordinate, value: float, error: float | None, bound: Bound | None
) -> FittedParameter:
    return FittedParameter(
        name=coordinate.name,
        value=float(value),
        std_error=error,
        initial=coordinate.initial,
        unit=parameter.unit,  # type: ignore[attr-defined]
        min=None if np.isinf(coordinate.lower) else coordinate.lower,
        max=None if np.isinf(coordinate.upper) else coordinate.upper,
        at_bound=bound,
    )


def _noises(
    problem: Problem,
    method: Method,
    measurement: dict[int, bool],
    intensity: np.ndarray,
    std: np.ndarray,
    coordinates: tuple[Coordinate, ...],
    errors: list[float | None],
    bounds: list[Bound | None],
) -> tuple[FittedNoise, ...]:
    """Process noises (pem only) and measurement noises with standard errors where they were searched."""
    searched = {(c.kind, c.index): i for i, c in enumerate(coordinates)}
    result = []
    if method == "pem":
        for k, noise in enumerate(problem.family.noises):
            i = searched.get(("process", k))
            error, bound = (None, None) if i is None else (errors[i], bounds[i])
            if bound is not None:
                error = None
            result.append(
                FittedNoise(
                    noise.name, "process", float(intensity[k]), error, noise.unit, i is not None, bound
                )
            )
    counts = observed_counts(problem.records)
    for j, output in enumerate(problem.family.outputs):
        if not counts[j]:
            continue
        i = searched.get(("measurement", j))
        # Eliminated noises: the variance of n squares, std(σ) = σ / √(2 n).
        error = float(std[j] / np.sqrt(2.0 * counts[j])) if measurement[j] else None
        bound = None
        if i is not None:
            error, bound = errors[i], bounds[i]
        result.append(
            FittedNoise(output.name, "measurement", float(std[j]), error, output.unit, measurement[j], bound)
        )
    return tuple(result)


def _initial_state(
    name: str, names: tuple[str, ...], x0: np.ndarray, part: Scores, cov: np.ndarray
) -> FittedInitialState:
    spread = part.initial_slope @ np.nan_to_num(cov) @ part.initial_slope.T
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.diagonal(part.initial_cov) + np.diagonal(spread))
    return FittedInitialState(name, names, x0, errors)


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
        same = sum(end.evaluation.value - best.evaluation.value < 1e-2 for end in ends)
        said.append(f"{same} of {len(ends)} starts reached this likelihood.")
    at_bound = [f"{p.name} ({p.at_bound})" for p in parameters if p.at_bound]
    if at_bound:
        said.append(f"At a bound: {', '.join(at_bound)}; widen the bound or look for what drives it there.")
    unknown = [p.name for p in parameters if p.std_error is None and not p.at_bound]
    if unknown:
        said.append(f"The data do not determine {', '.join(unknown)}: fix it, or measure more.")
    if weak:
        said += [_weak_text(direction) for direction in weak]
    absent = [f"{n.kind} noise at {n.name}" for n in noises if n.at_bound == "min"]
    if absent:
        said.append(f"The data ask for no {', no '.join(absent)}.")
    return " ".join(said)


def _weak_text(direction: WeakDirection) -> str:
    """One weak direction in words."""
    names, weights = list(direction.combination), set(direction.combination.values())
    size = (
        "not known at all" if np.isinf(direction.relative_std) else f"± {100 * direction.relative_std:.2g} %"
    )
    if len(names) == 1:
        return f"{names[0]} is hardly known ({size})."
    listed = ", ".join(names[:-1]) + " and " + names[-1]
    if weights == {1.0}:
        return f"{listed} are known only up to a common factor ({size}); fix one of them from another source."
    powers = " · ".join(f"{n}^{w:g}" for n, w in direction.combination.items())
    return f"{listed} can move together as {powers} ({size}); fix one of them from another source."


def _ending(best: Found) -> str:
    if best.reason == "converged":
        return f"Converged after {best.iterations} iterations."
    if best.reason == "stalled":
        return (
            f"No better point was found after {best.iterations} iterations, although a gain of "
            f"{best.predicted_gain:.2g} was expected: try other start values (--starts 5)."
        )
    return f"Stopped after {best.iterations} iterations without converging: allow more, or start elsewhere."
