"""Estimates of an effect without the coloured load that it replaced.

A coloured load with a long memory takes from a law whatever of it is slow, and leaves it half its size; an
honest test of whether the law is there needs such a load, its size does not. Here the loads are white: noise
of equal power at all frequencies can imitate no law. A filter with white loads suits a machine that is
shaken, and one whose errors add up; a simulation suits a model that lacks something besides, since it weighs
slow errors as a user of the model does. Both are tried, and the one that simulates unseen data better is
told.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, grown, loads_of, shortest_load, simulation_options
from daest.diagnosis.null_model.null_observer import NullObserver, run_null
from daest.diagnosis.screening.responses import nuisance
from daest.errors import DaestError
from daest.estimation.fitting.coordinates import Unknowns, parameter_coordinate
from daest.estimation.identify import identify
from daest.estimation.nonlinear.identify_nonlinear import Refit, WarmStart, search_on
from daest.model.experiment import Experiment
from daest.model.fit import Choice, FitResult, FittedParameter, IdentifyOptions, error_ratios
from daest.model.flat import ExplicitModel, FlatModel

FAILURES = (DaestError, RuntimeError, np.linalg.LinAlgError)  # of a search, also those of CasADi's solvers
ITERATIONS = 40
SECOND_CHANCES = 2  # searches that go on where one has come to its limit
BATCHES = 30  # of the record, whose scores count as independent: colour of the innovations shows in them
FEWEST_BATCHES = 8
SIMULATED_ITERATIONS = 40
ROUGH_START = 3  # iterations of the search for the initial states of a simulation that is to be rough
FAR = 100.0  # times its start value, or that part of it, at which a parameter may be lost
LOST = 5.0  # log-likelihood below that of a model which it contains, from which a search has lost its way


def settled(
    null: Null,
    fit: FitResult,
    flat: FlatModel,
    explicit: ExplicitModel,
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    *,
    is_rough: bool = False,
) -> tuple[FitResult, NullObserver] | None:
    """The fit of `flat`, a model that contains the null's loads and has the dynamics `explicit`, with white
    loads in their place, started from `fit`; and its observer over the experiments. None where no search
    from there succeeds. A rough one ends with the first pass of its search, and with a few iterations of
    that for the initial states of its simulations."""
    names = tuple(p.name for p in fit.parameters)
    times = null.shortest_times
    started = flat.with_theta({**fit.theta, **times})
    explicit = replace(explicit, flat=started)
    # Where the loads of the null lead astray, what is left of them beside the effect may not.
    beside = replace(null, fit=fit, loads=loads_of(fit, null.places))
    ends: list[Refit] = []
    for start in (null, beside):
        end = _found(start, started, explicit, names, experiments, is_rough)
        is_lost = end is not None and _has_run_away(end.fit, experiments)
        ends += [] if end is None or is_lost else [end]
        if end is None or not (is_lost or _is_led_away(end.fit, fit, null.estimated)):
            break
    if not ends:
        return None
    found = max(ends, key=lambda end: end.fit.log_likelihood)
    if not is_rough:
        given = _given(null)
        if _leaves_open(found.fit, given):
            again = replace(explicit, flat=started.with_theta(given))
            other = _found(null, again.flat, again, names, experiments, is_rough)
            if other is not None and other.fit.log_likelihood > found.fit.log_likelihood:
                found = other
    run = run_null(grown(null, started, explicit, found.fit, experiments))
    told = found.simulated(validation, ROUGH_START) if is_rough else found.simulated(validation)
    choice = Choice(fit.theta, GATES.error_of_choice)
    return replace(told, parameters=_uncertain(found.fit, choice, run), choice=choice), run


def _found(
    null: Null,
    started: FlatModel,
    explicit: ExplicitModel,
    names: Sequence[str],
    experiments: Sequence[Experiment],
    is_rough: bool,
) -> Refit | None:
    """The end of a search that goes on where it has come to its limit; None where it fails."""
    found: Refit | None = None
    for _ in range(1 + SECOND_CHANCES):
        try:
            found = _fit(null, started, explicit, names, experiments, found.fit if found else None, is_rough)
        except FAILURES:
            return None
        if is_rough or found.fit.status != "iteration limit":
            break
    return found


def _has_run_away(fit: FitResult, experiments: Sequence[Experiment]) -> bool:
    """Whether a search ended where no observer follows the data: there the noise of a sensor is beyond all
    that it shows."""
    spread = np.nanstd(np.concatenate([e.outputs for e in experiments]), axis=0)
    noise = np.array([n.value for n in fit.noises if n.kind == "measurement"])
    return bool(np.any(noise > GATES.observer_runaway * spread))


def _is_led_away(white: FitResult, beside: FitResult, names: Collection[str]) -> bool:
    """Whether white loads have led one of the parameters `names` far from where it is `beside` coloured ones:
    loads that are too large to begin with do what a parameter did, and it goes anywhere."""
    apart = [white.theta[name] / beside.theta[name] for name in names if beside.theta[name]]
    return any(_is_far(ratio) for ratio in apart)


def _is_far(ratio: float) -> bool:
    """Whether a ratio of two values of a parameter tells that one of them is lost."""
    return ratio > 0.0 and abs(np.log(ratio)) > np.log(FAR)


def fit_by_simulation(
    null: Null,
    white: FitResult,
    flat: FlatModel,
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    beside: Refit | None = None,
) -> FitResult | None:
    """The fit by simulation that starts at `white` (of `settled`), or at the refit `beside` coloured loads
    where that simulates better; None where it fails."""
    names = tuple(p.name for p in white.parameters)
    known = set(flat.parameter_names)
    given, is_lost = _given(null), _is_lost(null, white)
    begun = white.theta if beside is None else _better_in_simulation(white, beside)
    fixed = {name: T for name, T in null.shortest_times.items() if name in known}
    options = replace(simulation_options(null, names, SIMULATED_ITERATIONS), fix=fixed)
    ends: list[FitResult] = []
    for start in (begun, {**begun, **given}):
        if ends and not is_lost and not _is_flat(ends[0], given):
            break
        try:
            chosen_start = replace(options, start={name: start[name] for name in names})
            ends.append(identify(flat, experiments, chosen_start, validation))
        except FAILURES:
            continue
    return max(ends, key=lambda end: end.log_likelihood, default=None)


def better_of(white: FitResult, found: FitResult | None) -> FitResult:
    """The better of two fits, judged by the simulation of the validation data. The uncertainty of the one
    that was `found` by simulation includes the choice, as far as that is one: the distance to an estimate
    that simulates much worse counts little."""
    if found is None:
        return white
    ratios = error_ratios(white.simulated, found.simulated)
    share = float(np.sqrt(np.mean(np.square(ratios)))) if ratios else np.inf
    if not share < 1.0:
        return white
    choice = Choice({p.name: p.value for p in white.parameters}, GATES.error_of_choice * share)
    chosen = tuple(_with_choice(p, choice) for p in found.parameters)
    return replace(found, parameters=chosen, choice=choice)


def _given(null: Null) -> dict[str, float]:
    """The values of the model's parameters from which the user has them looked for."""
    return {p.name: p.initial for p in null.fit.parameters if p.name in null.estimated}


def _is_flat(end: FitResult, names: Collection[str]) -> bool:
    """Whether a search has come to no end, or to one where the data leave a parameter of the model open: it
    may lie anywhere along a valley, and is looked for from the values that the user gave, too."""
    return end.status != "converged" or _leaves_open(end, names)


def _leaves_open(end: FitResult, names: Collection[str]) -> bool:
    return any(
        p.std_error is None or p.std_error > GATES.open_parameter * abs(p.value)
        for p in end.parameters
        if p.name in names
    )


def _better_in_simulation(white: FitResult, beside: Refit) -> dict[str, float]:
    """The parameters of the one that simulates the recordings better: white loads may leave a model that
    bends much, such as one whose sensor has lost the sign, in another valley."""
    other = beside.simulated()
    ratios = error_ratios(
        {"validation": white.simulated["estimation"]}, {"validation": other.simulated["estimation"]}
    )
    return other.theta if ratios and float(np.mean(np.square(ratios))) < 1.0 else white.theta


def _is_lost(null: Null, white: FitResult) -> bool:
    """Whether the search beside the loads has led a parameter of the model far away from where the user has
    it looked for: a load that is free enough leaves it nothing to do."""
    starts = _given(null)
    apart = [white.theta[name] / value for name, value in starts.items() if value and name in white.theta]
    return any(_is_far(ratio) for ratio in apart)


def _with_choice(parameter: FittedParameter, choice: Choice) -> FittedParameter:
    if parameter.std_error is None:
        return parameter
    return replace(parameter, std_error=float(np.hypot(parameter.std_error, choice.of(parameter))))


def _fit(
    null: Null,
    flat: FlatModel,
    explicit: ExplicitModel,
    names: Sequence[str],
    experiments: Sequence[Experiment],
    before: FitResult | None,
    is_rough: bool,
) -> Refit:
    known = {p.name: p for p in flat.parameters}
    start = {name: known[name].value if before is None else before.theta[name] for name in names}
    coordinates = tuple(
        parameter_coordinate(flat, name, start[name], (known[name].min, known[name].max)) for name in names
    )
    n_w, n_y = len(flat.noises), len(flat.outputs)
    T = shortest_load(null.experiments)
    # A white load of the same size: the search over noise levels finds the rest.
    levels = {f"{load.name}.w": 2.0 * load.size**2 / T for load in null.loads}
    states, std = null.initial_states, null.measurement_std
    if before is not None:
        levels = {n.name: n.value for n in before.noises if n.kind == "process"}
        states = tuple(dict(zip(s.names, s.values, strict=True)) for s in before.initial_states)
    intensity = np.array([levels.get(w.name, 0.0) for w in flat.noises])
    return search_on(
        explicit,
        Unknowns(coordinates, flat.theta_values, np.zeros(n_w), np.ones(n_y)),
        experiments,
        np.array([w.name in levels for w in flat.noises], dtype=bool),
        IdentifyOptions(hold=null.hold, max_iterations=ITERATIONS),
        WarmStart(
            intensity,
            std,
            states,
            at_rest=tuple(load.name for load in null.loads),
            shares=(1.0,),
            is_rough=is_rough,
            stand_beside=before is None,
        ),
    )


def _uncertain(found: FitResult, choice: Choice, run: NullObserver) -> tuple[FittedParameter, ...]:
    """The parameters with standard errors that hold for innovations that are not white (sandwich, over
    batches of the record), and that include the choice between this estimate and the one beside the
    coloured load."""
    cov = _sandwich(run, found.parameters)
    result = []
    for i, parameter in enumerate(found.parameters):
        if parameter.std_error is None:
            result.append(parameter)
            continue
        own = max(parameter.std_error**2, float(cov[i, i]) if np.isfinite(cov[i, i]) else 0.0)
        result.append(_with_choice(replace(parameter, std_error=float(np.sqrt(own))), choice))
    return tuple(result)


def _sandwich(run: NullObserver, parameters: Sequence[FittedParameter]) -> np.ndarray:
    """Covariance (p, p) of the parameters from the scores of batches of the record; NaN where there are too
    few batches. What is known of them beforehand counts as information: without it, a direction in which no
    output changes would have rounding for its variance."""
    n_parameters = len(parameters)
    directions = nuisance(run, n_parameters)
    information = directions @ directions.T
    information[np.diag_indices(n_parameters)] += [_prior_precision(p) for p in parameters]
    inverse = np.linalg.pinv(information, hermitian=True)
    totals, first = [], 0
    samples = sum(o.whitened.shape[0] for o in run.observed)
    for observed in run.observed:
        n_samples, n_y = observed.whitened.shape
        n_batches = max(1, round(BATCHES * n_samples / samples))
        edges = first + n_y * np.linspace(0, n_samples, n_batches + 1).astype(int)
        white = run.whitened
        for a, b in pairwise(edges.tolist()):
            totals.append(directions[:, a:b] @ white[a:b])
        first += n_samples * n_y
    if len(totals) < FEWEST_BATCHES:
        return np.full((n_parameters, n_parameters), np.nan)
    scores = np.array(totals)
    whole = inverse @ (scores.T @ scores) @ inverse
    return whole[:n_parameters, :n_parameters]


def _prior_precision(parameter: FittedParameter) -> float:
    """Of what is known of a parameter beforehand, at its value: 1/unit²; 0 where nothing is."""
    prior = parameter.prior
    if prior is None:
        return 0.0
    is_scale = prior.mean > 0.0 < parameter.value and parameter.min is not None and parameter.min >= 0.0
    return (prior.std * (parameter.value / prior.mean if is_scale else 1.0)) ** -2
