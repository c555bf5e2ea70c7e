"""From the end of a search to a FitResult: estimates, uncertainty, verdict; whatever predicted."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from daest.estimation.fitting.coordinates import Coordinate, Unknowns, log_likelihood
from daest.estimation.fitting.identifiability import (
    ROUNDING,
    Scores,
    correlation,
    unseen_note,
    weak_directions,
)
from daest.estimation.fitting.profile import Searched, Tell, with_interval_check, with_profiles
from daest.estimation.fitting.search import Found
from daest.estimation.fitting.setup import Setup
from daest.estimation.fitting.signals import fit_percent, white_part
from daest.estimation.gates import FIT
from daest.model.experiment import Experiment
from daest.model.fit import (
    Agreement,
    Bound,
    FitResult,
    FittedInitialState,
    FittedNoise,
    FittedParameter,
    WeakDirection,
)
from daest.model.holds import Hold
from daest.model.parts import Parameter

COLOURED = "the simulation residuals are not white; the standard errors account for that"
FOLLOWING = (
    "the errors one step ahead are not white, and the standard errors take them as such: they are too small; "
    "declare the noise that acts (noise.process), or ask daest diagnose what is missing"
)
CUT = "no profile likelihood: the model is too unstable to be simulated from one initial state"


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
    parameters of the model, as `declared`; fields as in `FitResult`."""

    declared: Sequence[Parameter]
    theta: np.ndarray
    noises: tuple[FittedNoise, ...]
    noise_model: Literal["white", "held"]
    initial_states: tuple[FittedInitialState, ...]
    period: float | None
    hold: Hold
    notes: tuple[str, ...]
    unseen: tuple[str, ...]


class Ends(Protocol):
    """Where the searches of one fit ended, and what its predictor makes of the best end."""

    @property
    def found(self) -> list[Found]:
        """The ends, best first."""

    @property
    def searched(self) -> Searched | None:
        """The search that led to the best end; None where no objective over whole records did."""

    def agreements(self, experiments: tuple[Experiment, ...] | None = None) -> tuple[Agreement, Agreement]:
        """Of simulations and of one-step predictions with the recordings; None: those that were fitted."""

    def judged(self) -> tuple[End, Told]:
        """The best end with its uncertainty."""


def fit_result(setup: Setup, ends: Ends, tell: Tell, began: float) -> FitResult:
    """The result of a fit that `began` then (time.perf_counter), with the profiles that are asked for."""
    agreements = {"estimation": ends.agreements()}
    if setup.validation:
        agreements["validation"] = ends.agreements(setup.validation)
    result = assembled(setup, ends, agreements)
    options, searched = setup.options, ends.searched
    if searched is None:
        note = (CUT,) if options.profile else ()
        result = replace(result, notes=(*result.notes, *note))
    else:
        if options.second_look:
            result = with_interval_check(result, searched)
        if options.profile:
            result = with_profiles(result, searched, options.profile, tell)
    return replace(result, seconds=time.perf_counter() - began)


def assembled(setup: Setup, ends: Ends, agreements: dict[str, tuple[Agreement, Agreement]]) -> FitResult:
    """The result of the best end, with `agreements` of simulations and predictions by part of the data."""
    end, told = ends.judged()
    best, unknowns = ends.found[0], end.unknowns
    own = unknowns.of_kind("parameter")
    initial = {c.name: c.initial for c in setup.unknowns.coordinates}
    parameters = tuple(
        _fitted_parameter(
            replace(c, initial=initial[c.name]), told.declared, end.values[i], end.errors[i], end.bounds[i]
        )
        for i, c in enumerate(unknowns.coordinates)
        if c.kind == "parameter"
    )
    rows = np.ix_(own, own)
    slopes = unknowns.slopes(best.z[: len(unknowns.coordinates)])[own]
    information = end.information[rows] / np.outer(slopes, slopes)
    coordinates = tuple(unknowns.coordinates[i] for i in own)
    weak = weak_directions(coordinates, end.values[own], information, end.cov[rows])
    return FitResult(
        status=best.reason,
        message=_message(best, parameters, told.noises, weak, ends.found),
        method=setup.method,
        parameters=parameters,
        theta={p.name: float(v) for p, v in zip(told.declared, told.theta, strict=True)},
        noises=told.noises,
        noise_model=told.noise_model,
        initial_states=told.initial_states,
        correlation_names=tuple(c.name for c in unknowns.coordinates),
        correlation=correlation(end.cov),
        weak_directions=weak,
        weak_threshold=FIT.weak_direction,
        log_likelihood=log_likelihood(unknowns, best),
        start_log_likelihoods=tuple(log_likelihood(unknowns, one) for one in ends.found),
        simulated={part: simulated for part, (simulated, _) in agreements.items()},
        one_step={part: predicted for part, (_, predicted) in agreements.items()},
        n_samples=sum(e.n_samples for e in setup.experiments),
        n_iterations=best.iterations,
        seconds=0.0,
        period=told.period,
        hold=told.hold,
        notes=(*setup.notes, *told.notes, *unseen_note(told.unseen)),
        unseen_states=told.unseen,
    )


def common_period(recordings: Iterable[Recorded]) -> float | None:
    """The period of all recordings; None where they differ."""
    periods = {recording.period for recording in recordings}
    return periods.pop() if len(periods) == 1 else None


def _fitted_parameter(
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
    """The initial state of one recording, with what the covariance `cov` of the unknowns adds to its own.
    Shapes: x0 (n_x,), cov (d, d) of the d unknowns."""
    spread = part.initial_slope @ np.nan_to_num(cov) @ part.initial_slope.T
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.diagonal(part.initial_cov) + np.diagonal(spread))
    return FittedInitialState(name, names, x0, errors)


def bound_of(coordinate: Coordinate, z: float) -> Bound | None:
    """The bound that z rests at."""
    if z <= coordinate.searched(coordinate.lower) + FIT.at_bound:
        return "min"
    if z >= coordinate.searched(coordinate.upper) - FIT.at_bound:
        return "max"
    return None


def _message(
    best: Found,
    parameters: tuple[FittedParameter, ...],
    noises: tuple[FittedNoise, ...],
    weak: tuple[WeakDirection, ...],
    ends: Sequence[Found],
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
    powers = " · ".join(n if w == 1.0 else f"{n}^{w:g}" for n, w in direction.combination.items())
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


def agreement_of(
    names: Sequence[str], measured: Sequence[np.ndarray], errors: Sequence[np.ndarray] | None
) -> Agreement:
    """Agreement from the errors of all experiments (n_samples, n_y), NaN where missing; None: no errors."""
    fits: dict[str, float | None] = dict.fromkeys(names)
    rms: dict[str, float | None] = dict.fromkeys(names)
    white: dict[str, float | None] = dict.fromkeys(names)
    for j, name in enumerate(names if errors is not None else ()):
        assert errors is not None
        left = np.concatenate([e[np.isfinite(e[:, j]), j] for e in errors])
        if left.size:
            rms[name] = float(np.sqrt(np.mean(left**2)))
            fits[name] = fit_percent((m[:, j] for m in measured), float(np.sum(left**2)))
            white[name] = white_part([m[:, j] for m in measured], (e[:, j] for e in errors))
    return Agreement(fits, rms, white)
