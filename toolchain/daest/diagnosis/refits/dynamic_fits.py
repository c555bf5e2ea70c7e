"""Effects that change the order of the model, fitted by simulation.

An effect without a regular null has no derivative there that the screen could score; it is fitted by output
error instead, which is cheap while the model stays affine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np

from daest.diagnosis.built_in.dead_times import DELAY, SHIFTS, best_shift
from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.built_in.trials import Prepared, Trial
from daest.diagnosis.evidence.proof import bic_gain
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, period_of, simulation_options
from daest.diagnosis.null_model.null_observer import RTOL
from daest.errors import DaestError
from daest.estimation.identify import identify, searched
from daest.model.diagnosis import Candidate, Screen
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import FlatModel
from daest.modelica.effects.attach import attach
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.linear.state_space import state_space_family
from daest.systems.reduction.reduce import reduce_index

MOST_DYNAMIC = 2  # of them go to the proof
ITERATIONS = 15
LAGS = (1.0, 10.0, 100.0)  # sampling periods, from which the size of a delay or lag is looked for
BENT_LAGS = LAGS[:2]  # the same where every run takes longer
DETECTABLE_SHARES = (10.0, 100.0)  # of the size that the screen would see, for storage
START_SHARES = (1.0, 30.0)  # of the library's start value, for sizes whose scale the machine decides


@dataclass(frozen=True)
class _Effort:
    """Of a search from several starts: `iterations` from each, then to the end from the `most` best of those
    that have gained `least_gain` in log-likelihood. Of more than `followed` starts, those that are best after
    a single iteration."""

    iterations: int
    most: int
    least_gain: float
    followed: int = 100


DYNAMIC = _Effort(iterations=4, most=1, least_gain=1.0)
STORAGE = _Effort(iterations=1, most=2, least_gain=-np.inf)
BENT = _Effort(iterations=5, most=1, least_gain=0.0, followed=3)  # a model that bends, whose runs take longer

Simulation = tuple[float, dict[str, float]]  # log-likelihood and all parameters of a fit by simulation
Fit = Callable[[IdentifyOptions], Simulation]
DynamicFits = Sequence[tuple[float, Prepared]]  # log-likelihoods of simulations with the effects


def dynamic_fits(null: Null, wanted: Sequence[Candidate], simulation: Simulation) -> DynamicFits:
    """Output-error fits of those of the wanted effects with states that improve the simulation; for models
    with affine dynamics, where such a fit takes a fraction of a second.

    They start from the `simulation` of the model as it is (`best_simulation`): beside loads that are free
    enough to take the place of an effect with states, the null's parameters may have gone anywhere."""
    fits = []
    for one in wanted:
        starts = _from_period(null, one, LAGS) if one.is_of_signal else _from_library(one)
        fits.append(_best_fit(null, one, starts, simulation, DYNAMIC))
    return _improving(fits, simulation)


def storage_fits(
    null: Null, found: Screen, wanted: Sequence[Candidate], simulation: Simulation
) -> DynamicFits:
    """Output-error fits of the wanted effects with states of their own, those that leave the dynamics affine
    and improve the simulation: a mass that hangs on a spring, a wall behind a room. Half of its own mass
    moves a resonance so far that no derivative at size zero tells of it. They start from the shapes of the
    screen `found`, with multiples of the sizes that it would see."""
    fits = [_best_fit(null, one, _from_screen(found, one), simulation, STORAGE) for one in wanted]
    return _improving(fits, simulation)


def bent_fits(
    null: Null,
    found: Screen,
    wanted: Sequence[Candidate],
    nominal: FitResult,
    lags: DynamicFits = (),
) -> DynamicFits:
    """Output-error fits of those of the wanted effects with states that improve the simulation of a model
    that is not affine, started from the `nominal` one (`nominal_simulation`), delays from multiples of the
    sampling period: as many fits of a model that bends as for an affine one would take too long. Where
    `lags` were found at the same signal, a dead time starts from the shift of the recordings that fits best
    beside one, and is not fitted where that comes nowhere near to it."""
    simulation, fits = (nominal.log_likelihood, nominal.theta), []
    for candidate in wanted:
        lag = _lag_at(candidate, lags)
        if candidate.effect.class_name == DELAY and candidate.is_of_recorded and lag is not None:
            fits.append(_dead_time(null, candidate, nominal, lag))
            continue
        if candidate.is_of_signal:
            starts = _from_period(null, candidate, BENT_LAGS)
        else:
            starts = _from_library(candidate) if candidate.is_dynamic else _from_screen(found, candidate)
        fits.append(_best_fit(null, candidate, starts, simulation, BENT))
    return _improving(fits, simulation)


def _from_period(null: Null, candidate: Candidate, shares: Sequence[float]) -> list[dict[str, float]]:
    """Sizes of an effect that delays a signal: how fast the machine is the library cannot know, the one who
    chose the sampling period did."""
    own = candidate.effect.sizes[0].name
    return [{own: share * period_of(null.experiments)} for share in shares]


def _lag_at(candidate: Candidate, lags: DynamicFits) -> tuple[float, Prepared] | None:
    """The likeliest of the `lags` at the signal of a candidate."""
    there = [pair for pair in lags if pair[1].trial.candidate.site == candidate.site]
    return max(there, key=lambda pair: pair[0], default=None)


def _dead_time(
    null: Null, candidate: Candidate, nominal: FitResult, lag: tuple[float, Prepared]
) -> tuple[float, Prepared] | None:
    """The output-error fit of a dead time, from the best shift of the recordings near to the time constant of
    the `lag`; None where a shift gains much less than that does."""
    value, prepared = lag
    values = {p.name: p.value for p in prepared.flat.parameters}
    own = prepared.trial.candidate
    T = values[f"{own.name}.{own.effect.sizes[0].name}"]
    start = {name: nominal.theta[name] for name in null.estimated}
    options = replace(simulation_options(null, null.estimated, ITERATIONS), start=start, rtol=RTOL)
    shift = best_shift(null, candidate.site, [share * T for share in SHIFTS], options)
    before = nominal.log_likelihood
    if shift is None or shift.log_likelihood - before < GATES.min_shift_gain * (value - before):
        return None
    size = {candidate.effect.sizes[0].name: shift.delay}
    return _best_fit(null, candidate, [size], (before, {**nominal.theta, **shift.theta}), BENT)


def _from_library(candidate: Candidate) -> list[dict[str, float]]:
    return [{p.name: share * p.start for p in candidate.effect.sizes} for share in START_SHARES]


def _from_screen(found: Screen, candidate: Candidate) -> list[dict[str, float]]:
    shaped = [e for e in found.entries if e.candidate.name.rpartition("_")[0] == candidate.name]
    return [
        {**entry.candidate.shape, candidate.effect.sizes[0].name: share * entry.detectable}
        for entry in shaped
        for share in DETECTABLE_SHARES
        if np.isfinite(entry.detectable) and entry.detectable > 0.0
    ]


def nominal_simulation(null: Null, reference: FitResult) -> FitResult | None:
    """The output-error fit of a model that is not affine as it is, which the `reference` may be, and which
    starts there; None where it fails."""
    if reference.method == "oe":
        return reference
    start = {name: reference.theta[name] for name in null.estimated}
    with suppress(*FAILURES):
        options = simulation_options(null, null.estimated, ITERATIONS)
        return identify(null.flat, null.experiments, replace(options, start=start))
    return None


def _improving(fits: Sequence[tuple[float, Prepared] | None], simulation: Simulation) -> DynamicFits:
    return [fit for fit in fits if fit is not None and fit[0] - simulation[0] >= GATES.min_dynamic_gain]


def best_dynamic(null: Null, parts: Sequence[DynamicFits]) -> tuple[Prepared, ...]:
    """The best of all parts of `dynamic_fits` by the criterion of Bayes, each law with the places where it
    does the same; and besides a law that delays a signal with many states the one that does with the fewest.
    Those states take up what else is missing, so that a dead time may simulate better where a lag is."""
    found: list[tuple[float, Prepared]] = []
    for best in chain.from_iterable(parts):
        same = next((i for i, (value, p) in enumerate(found) if _is_same(value, p, best)), None)
        if same is None:
            found.append(best)
        else:
            value, first = found[same]
            alike = (*first.trial.alike, best[1].trial.candidate)
            found[same] = (value, replace(first, trial=replace(first.trial, alike=alike)))
    found.sort(key=lambda pair: -bic_gain(pair[0], pair[1].n_unknowns(null.estimated), null))
    ordered = [prepared for _, prepared in found]
    return tuple(_with_simplest(ordered[:MOST_DYNAMIC], ordered))


def _with_simplest(chosen: list[Prepared], all_of_them: Sequence[Prepared]) -> list[Prepared]:
    """The chosen ones, and those of all that delay the same signals as they do with fewer states."""
    for one in list(chosen):
        candidate = one.trial.candidate
        simpler = [
            other
            for other in all_of_them
            if candidate.is_of_signal
            and candidate.site in [place.site for place in _places(other)]
            and other.trial.candidate.effect.n_states < candidate.effect.n_states
            and not any(other is known for known in chosen)
        ]
        chosen += sorted(simpler, key=lambda other: other.trial.candidate.effect.n_states)[:1]
    return chosen


def _places(prepared: Prepared) -> tuple[Candidate, ...]:
    """The places where a law is known to do the same."""
    return (prepared.trial.candidate, *prepared.trial.alike)


def _is_same(value: float, prepared: Prepared, other: tuple[float, Prepared]) -> bool:
    effects = (prepared.trial.candidate.effect.class_name, other[1].trial.candidate.effect.class_name)
    return effects[0] == effects[1] and abs(value - other[0]) < GATES.same_fit


def _best_fit(
    null: Null,
    candidate: Candidate,
    starts: Sequence[Mapping[str, float]],
    simulation: Simulation,
    effort: _Effort,
) -> tuple[float, Prepared] | None:
    """The likeliest output-error fit of the model with a candidate, from some of its parameters at each of
    the `starts`, the others as declared; None where the model has no fit (`_model_with`) or none gains enough
    to be pursued."""
    model = _model_with(null, candidate, starts[0]) if starts else None
    if model is None:
        return None
    flat, fitted = model
    names = (*null.estimated, *candidate.estimated)
    nominal, known = simulation
    options = replace(simulation_options(null, names, ITERATIONS), least=nominal + GATES.min_dynamic_gain)

    def followed(begun: Sequence[Mapping[str, float]], iterations: int) -> list[Simulation]:
        found = []
        for start in begun:
            with suppress(*FAILURES):
                found.append(fitted(replace(options, start=start, max_iterations=iterations)))
        return sorted(found, key=_likelihood, reverse=True)

    def begun_at(values: Mapping[str, float]) -> dict[str, float]:
        own = {f"{candidate.name}.{name}": value for name, value in values.items()}
        start = {name: known[name] for name in null.estimated}
        return start | {name: value for name, value in own.items() if name in names}

    begun = [begun_at(values) for values in starts]
    if len(begun) > effort.followed:
        begun = [{name: theta[name] for name in names} for _, theta in followed(begun, 1)[: effort.followed]]
    first = followed(begun, effort.iterations)
    pursued = [fit for fit in first[: effort.most] if fit[0] - nominal >= effort.least_gain]
    ends = list(pursued)
    for _, theta in pursued:
        with suppress(*FAILURES):
            whole = replace(options, start={name: theta[name] for name in names})
            ends.append(fitted(whole))
    if not ends:
        return None
    value, theta = max(ends, key=_likelihood)
    sizes = tuple(theta[f"{candidate.name}.{p.name}"] for p in candidate.effect.sizes)
    trial = Trial(candidate, sizes, (), is_seen_in_use=True)
    return value, Prepared(trial, flat.with_theta(theta), names, simulated=value)


def _model_with(
    null: Null, candidate: Candidate, values: Mapping[str, float]
) -> tuple[FlatModel, Fit] | None:
    """The model with the candidate, whose parameters have the `values`, and what fits it; None where it
    cannot be solved, or is not affine although the model without the candidate is."""
    try:
        flat = attach(null.flat, candidate.effect, candidate.site, candidate.name, values)
        explicit = reduce_index(flat)
        if has_affine_dynamics(explicit):
            return flat, partial(searched, state_space_family(explicit), null.experiments)
    except DaestError:
        return None
    return None if has_affine_dynamics(null.explicit) else (flat, partial(_bent_fit, flat, null.experiments))


def _bent_fit(flat: FlatModel, experiments: Sequence[Experiment], options: IdentifyOptions) -> Simulation:
    fit = identify(flat, experiments, replace(options, rtol=RTOL))
    return fit.log_likelihood, fit.theta


def _likelihood(found: Simulation) -> float:
    return found[0]


def best_simulation(null: Null) -> Simulation | None:
    """The better of two fits of the model as it is by simulation, from the null's parameters and from those
    that its search began with; None where neither succeeds, and where its dynamics are not affine."""
    if not has_affine_dynamics(null.explicit):
        return None
    begun = {p.name: p.initial for p in null.fit.parameters if p.name in null.estimated}
    family, found = state_space_family(null.explicit), []
    for start in ({}, begun):
        with suppress(DaestError):
            options = replace(simulation_options(null, null.estimated, ITERATIONS), start=start)
            found.append(searched(family, null.experiments, options))
    return max(found, key=_likelihood, default=None)
