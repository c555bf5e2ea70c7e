"""The fit of a linear model: where its searches start, where they end, and what the end is worth.

Start values of the measurement noise come from the roughness of the residuals, those of the process noise
from a scan.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from typing import Literal

import numpy as np

from daest.estimation.fitting.coordinates import Coordinate, Unknowns, objective, prior_precisions, rescaled
from daest.estimation.fitting.identifiability import (
    Scores,
    Uncertainty,
    are_coloured,
    covariance,
    output_error_covariance,
    std_errors,
    unseen_directions,
    without_influence,
)
from daest.estimation.fitting.optimum import MOST_PROBED, Search, best_point, coloured, rank
from daest.estimation.fitting.profile import Searched, Tell
from daest.estimation.fitting.records import Record, make_record, observed_counts
from daest.estimation.fitting.result import (
    COLOURED,
    FOLLOWING,
    End,
    Told,
    agreement_of,
    bound_of,
    common_period,
    fitted_initial_state,
)
from daest.estimation.fitting.search import Evaluation, Found, minimise
from daest.estimation.fitting.setup import Setup, check_start
from daest.estimation.gates import FIT
from daest.estimation.linear.arx import matched_start
from daest.estimation.linear.hold_search import are_steps, moving_inputs, possible_holds, ranked_holds
from daest.estimation.linear.linear_predictors import (
    Predicted,
    Problem,
    all_scores,
    innovation_slopes,
    simulate,
)
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, Bound, FittedNoise
from daest.model.holds import FOH, SMOOTH, Hold
from daest.model.linear import StateSpaceFamily
from daest.numerics.exponential import covariance_integral, transition_integrals
from daest.numerics.parallel import workers
from daest.systems.linear.state_space import family_for, state_space
from daest.systems.reduction.input_slopes import acting_slopes_of, theta_in_use

HOLD_ITERATIONS = 10  # of the short output-error fits that compare the holds
HOLD_SAMPLES = 4000  # of every recording that this comparison uses
SIMULATION_ITERATIONS = 15  # of the output-error fit that a prediction-error fit starts from
DOUBT_STARTS = 3  # random start points that are tried then
ENDS_ALIKE = 3  # of other starts: two may be led into the same wrong valley (1 of 200 random models)
SCAN_DECADES = (-8, -6, -5, -4, -3, -2, -1, 0, 1, 2, 3)  # of the intensity that explains all of the residual
LOWEST_DECADE = -10  # bound of the search: less noise than that is none
LONGEST_GROWTH = 1000  # periods over which process noise is let grow to see what it does to the outputs


def linear_start(family: StateSpaceFamily, setup: Setup) -> tuple[Setup, Problem, Evaluation | None]:
    """The setup in scales of the data, the simulation that a search begins with, and what it says at its
    start; None where it says nothing."""
    records = tuple(make_record(e, family) for e in setup.experiments)
    has_direct_noise = bool(np.any(state_space(family, setup.unknowns.theta).H != 0.0))
    sampled: Literal["white", "held"] = "held" if has_direct_noise else "white"
    simulation = Problem(family, records, "foh", setup.unknowns, setup.estimate_std, sampled)
    at_start = partial(objective(simulation), setup.unknowns.start, True)
    setup = replace(setup, unknowns=rescaled(setup.unknowns, at_start, setup.n_observed))
    simulation = replace(simulation, unknowns=setup.unknowns)
    hold = _chosen_hold(simulation, setup.experiments, setup.options.hold)
    simulation = _with_hold(simulation, setup.experiments, hold)
    return setup, simulation, _at_start(setup, simulation)


def absorbed_by_starts(setup: Setup, problem: Problem, start: Evaluation) -> tuple[str, ...]:
    """The parameters that move outputs, but not otherwise than free initial states do: the zero of a sensor
    of a height that an acceleration is integrated to."""
    dead = without_influence(start.information, setup.n_observed)
    found = problem.predict(problem.unknowns.start, with_slopes=True) if np.any(dead) else None
    if found is None:
        return ()
    parts = zip(found.recursions, found.records, found.found, found.initial_states, strict=True)
    moving = np.any([np.any(innovation_slopes(*part), axis=(1, 2)) for part in parts], axis=0)
    names = problem.unknowns.parameter_names()
    return tuple(n for n, absorbed in zip(names, dead[: len(names)] & moving, strict=True) if absorbed)


def linear_ends(family: StateSpaceFamily, setup: Setup, tell: Tell) -> LinearEnds:
    """The ends of the searches for the parameters of a linear model. Raises EstimationError
    `identify-no-start`, `identify-no-influence` and `identify-unidentifiable`."""
    setup, simulation, start = linear_start(family, setup)
    check_start(simulation.unknowns, start, setup.n_observed)
    problem, found = _search(setup, simulation, tell)
    return LinearEnds(setup, problem, found)


@dataclass(frozen=True)
class LinearEnds:
    """Where the searches ended, best first, of the predictors `problem`."""

    setup: Setup
    problem: Problem
    found: list[Found]

    @property
    def searched(self) -> Searched:
        unknowns = self.problem.unknowns
        return Searched(objective(self.problem), unknowns, unknowns.lower, unknowns.upper, self.found[0])

    def agreements(self, experiments: tuple[Experiment, ...] | None = None) -> tuple[Agreement, Agreement]:
        """Of the simulation and of the one-step prediction; every record starts where it fits best."""
        records = self.problem.records
        if experiments is not None:
            records = tuple(make_record(e, self.problem.family, self.problem.hold) for e in experiments)
        problem, z = replace(self.problem, records=records), self.found[0].z
        simulated = _agreement(problem, replace(problem, is_filtered=False, begins_level=True).predict(z))
        return simulated, _agreement(problem, problem.predict(z)) if problem.is_filtered else simulated

    def judged(self) -> tuple[End, Told]:
        """Bounds first: an unknown that rests at one is left out of the covariance of the others."""
        problem, best = self.problem, self.found[0]
        unknowns, family = problem.unknowns, problem.family
        parts, predicted = _end_scores(problem, best.z)
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
        theta, intensity, _ = unknowns.values(best.z)
        ss, steps = state_space(family, theta), np.diff(problem.records[0].time)
        states = zip(problem.records, predicted.initial_states, parts, strict=True)
        told = Told(
            declared=family.parameters,
            theta=theta,
            noises=(
                *(_process_noises(problem, intensity, end) if problem.is_filtered else ()),
                *_measurement_noises(problem, self.setup.estimate_std, predicted.measurement_std, end),
            ),
            noise_model=problem.sampled,
            initial_states=tuple(
                fitted_initial_state(record.name, family.state_names, x0, part, cov)
                for record, x0, part in states
            ),
            period=common_period(problem.records),
            hold=problem.hold,
            notes=_notes(problem, parts, in_z),
            unseen=unseen_directions(ss.A, ss.C, float(np.median(steps)), family.state_names),
        )
        return end, told


def needed_slopes(family: StateSpaceFamily, unknowns: Unknowns) -> list[int]:
    """The inputs by whose derivatives the model moves, whatever its unknown parameters are."""
    theta = theta_in_use(family.parameters, unknowns.parameter_names(), unknowns.theta)
    return [i for i, _ in acting_slopes_of(state_space(family, theta))] if family.input_derivatives else []


def _chosen_hold(problem: Problem, experiments: Sequence[Experiment], given: Hold | None) -> Hold:
    """The given hold, or the one with the higher likelihood after short output-error fits."""
    family = problem.family
    if given is not None:
        return given
    names = moving_inputs(experiments, family.input_names)
    asked = possible_holds(experiments, names, bool(needed_slopes(family, problem.unknowns)))
    if not names or len(asked) < 2:
        return FOH
    unknowns = problem.unknowns
    best: Found | None = None

    def likelihood(hold: Hold) -> float | None:
        nonlocal best
        z = unknowns.start if best is None else best.z
        held = _with_hold(problem, experiments, hold)
        short = replace(held, records=tuple(_head(r, HOLD_SAMPLES) for r in held.records))
        found = minimise(objective(short), z, unknowns.lower, unknowns.upper, HOLD_ITERATIONS)
        best = found or best
        return None if found is None else -found.evaluation.value

    ranked = ranked_holds(names, likelihood, asked, are_steps(experiments, names))
    return ranked[0] if ranked else FOH


def _with_hold(problem: Problem, experiments: Sequence[Experiment], hold: Hold) -> Problem:
    """The problem of inputs that are held or straight, with inputs that do so between their samples."""
    if hold != SMOOTH:
        return replace(problem, hold=hold)
    family = family_for(problem.family, hold)
    records = tuple(make_record(e, family, hold) for e in experiments)
    return replace(problem, family=family, records=records, hold=hold)


def _head(record: Record, n_samples: int) -> Record:
    """The first samples of a record."""
    return replace(
        record,
        time=record.time[:n_samples],
        inputs=record.inputs[:n_samples],
        outputs=record.outputs[:n_samples],
        observed=record.observed[:n_samples],
        recorded=record.recorded[record.recorded < n_samples],
    )


def _at_start(setup: Setup, problem: Problem) -> Evaluation | None:
    start: Evaluation | None = objective(problem)(problem.unknowns.start, True)
    if start is None and setup.method == "pem":
        noisy = _with_noise(setup, problem, problem.unknowns.start)
        whole = objective(noisy)(noisy.unknowns.start, True)
        p = len(problem.unknowns.coordinates)
        if whole is not None:
            start = Evaluation(whole.value, whole.gradient[:p], whole.information[:p, :p])
    return start


def _search(setup: Setup, simulation: Problem, tell: Tell) -> tuple[Problem, list[Found]]:
    """The problem that was searched, and the end of the search from every start, best first.

    In doubt, other starts are tried until one leaves white residuals, or ENDS_ALIKE of them end where the
    first one did: then it is the model that leaves them coloured.
    """
    began = time.perf_counter()
    unknowns, options = setup.unknowns, setup.options
    first = _simulated_from(setup, simulation, unknowns.start)
    pairs = [_search_from(setup, simulation, unknowns.start, first)]
    seconds = time.perf_counter() - began
    if options.starts > 1:
        pairs += _from_other_starts(setup, simulation, first, pairs[0], seconds, tell)
    elif options.second_look and options.max_iterations:
        for level, start in _second_looks(simulation, options.seed):
            alike = sum(_ends_alike(pairs[0], pair) for pair in pairs[1:])
            if not _is_doubtful(pairs[-1], level) or alike >= ENDS_ALIKE:
                break
            z = start()
            if z is not None:
                end = _other_end(setup, simulation, first, z)
                pairs.append(pairs[0] if isinstance(end, _Same) else end)
    ended = [pair for pair in pairs if pair is not None]
    if not ended:
        check_start(unknowns, None, 0)
    ended.sort(key=lambda pair: rank(pair[1]))
    return ended[0][0], [found for _, found in ended]


class _Same:
    """In place of an end: the search led to where the first one did."""


Pair = tuple[Problem, Found] | None


def _second_looks(simulation: Problem, seed: int) -> Iterator[tuple[float, Callable[[], np.ndarray | None]]]:
    """Levels of the doubt that makes another start worth trying, and the start: one that matches ARX models
    where anything is suspicious, random ones where the residuals are not white."""
    yield FIT.suspicious_level, lambda: matched_start(simulation, seed)
    for z in _random_starts(simulation.unknowns, DOUBT_STARTS, seed):
        yield FIT.random_start_level, partial(np.asarray, z)


def _from_other_starts(
    setup: Setup, simulation: Problem, first: Found | None, end: Pair, seconds: float, tell: Tell
) -> list[Pair]:
    options = setup.options
    matched = matched_start(simulation, options.seed)
    random = _random_starts(setup.unknowns, options.starts - 1, options.seed)
    starts = [*([] if matched is None else [matched]), *random]
    search = partial(_other_end, setup, simulation, first)
    done = count(2)
    with workers(options.jobs, options.cluster) as pool:
        found = pool.map(
            search,
            starts,
            seconds=seconds,
            arrived=lambda *_: tell(f"searched from start point ({next(done)} of {len(starts) + 1})"),
        )
        ends = [outcome.get() for outcome in found]
    return [end if isinstance(one, _Same) else one for one in ends]


def _other_end(setup: Setup, problem: Problem, first: Found | None, z: np.ndarray) -> Pair | _Same:
    simulated = _simulated_from(setup, problem, z)
    # The same simulation leads on to the same likelihood.
    return _Same() if _is_same(first, simulated) else _search_from(setup, problem, z, simulated)


def _is_same(one: Found | None, other: Found | None) -> bool:
    if one is None or other is None:
        return False
    return abs(one.evaluation.value - other.evaluation.value) < FIT.same_simulation


def _ends_alike(one: Pair, other: Pair) -> bool:
    if one is None or other is None:
        return False
    return abs(one[1].evaluation.value - other[1].evaluation.value) < FIT.same_optimum


def _simulated_from(setup: Setup, problem: Problem, z: np.ndarray) -> Found | None:
    """The end of the output-error search: the whole search, or where that of the likelihood begins."""
    unknowns = problem.unknowns
    if setup.method == "oe":
        return best_point(_searched(setup, problem, unknowns.start), [z])
    return minimise(objective(problem), z, unknowns.lower, unknowns.upper, SIMULATION_ITERATIONS)


def _searched(setup: Setup, problem: Problem, home: np.ndarray) -> Search:
    """The search over the unknowns of `problem`. Without a second look it trusts its parabola; that of a
    simulation then looks over no hills unless they are asked for."""
    unknowns, options = problem.unknowns, setup.options
    is_quick = setup.method == "oe" and not options.second_look and not options.hills
    return Search(
        objective(problem),
        unknowns,
        unknowns.lower,
        unknowns.upper,
        home,
        options.max_iterations,
        hills=0 if is_quick else MOST_PROBED,
        trusts_parabola=not options.second_look,
        goal=-options.least,
    )


def _search_from(setup: Setup, simulation: Problem, z: np.ndarray, simulated: Found | None) -> Pair:
    """The end of the search from z. Process noise biases what a simulation ends at, or leads it astray: the
    likelihood is searched both from there and from z itself."""
    if setup.method == "oe":
        return None if simulated is None else (simulation, simulated)
    starts = [
        _with_noise(setup, simulation, start) for start in ([] if simulated is None else [simulated.z]) + [z]
    ]
    noisy = _with_common_bounds(starts)
    unknowns = noisy.unknowns
    given = setup.unknowns.start
    home = np.concatenate([given, unknowns.start[given.size :]])
    search = _searched(setup, noisy, home)

    def is_doubtful(found: Found) -> bool:
        return _is_doubtful((noisy, found), FIT.suspicious_level)

    found = best_point(search, [start.unknowns.start for start in starts], is_doubtful)
    return None if found is None else (noisy, found)


def _random_starts(unknowns: Unknowns, count: int, seed: int) -> list[np.ndarray]:
    """Random points: within the bounds where both are finite, else around the start."""
    rng = np.random.default_rng(seed)
    bounded = np.isfinite(unknowns.lower) & np.isfinite(unknowns.upper)
    low, high = unknowns.range_around(unknowns.start, bounded)
    return [rng.uniform(low, high) for _ in range(count)]


def _is_doubtful(pair: Pair, level: float) -> bool:
    """Whether a better optimum may exist than the end of a search: its residuals are not white at that
    level, or the level is that of a suspicion and the search did not converge."""
    if pair is None or (level == FIT.suspicious_level and pair[1].reason != "converged"):
        return True
    problem, found = pair
    parts, _ = _end_scores(problem, found.z)
    return coloured([part.residuals for part in parts], [r.observed for r in problem.records], level)


def _with_noise(setup: Setup, problem: Problem, z_parameters: np.ndarray) -> Problem:
    """The Kalman predictors of a simulation, with coordinates of the noises that are estimated. Start values
    of those that are unknown are the best of a scan at the parameters `z_parameters`."""
    theta = problem.unknowns.values(z_parameters)[0]
    residual_std, rough_std = _residual_sizes(problem, theta)
    unit = _reference_intensities(problem, theta, residual_std)
    std = np.where(np.isnan(setup.std), rough_std, setup.std)
    parameters = tuple(
        replace(c, initial=value)
        for c, value in zip(problem.unknowns.coordinates, problem.unknowns.natural(z_parameters), strict=True)
    )
    best: tuple[float, Problem] | None = None
    is_unknown = np.any(setup.estimate_intensity & np.isnan(setup.intensity))
    for decade in SCAN_DECADES if is_unknown else (0,):
        intensity = np.where(np.isnan(setup.intensity), unit * 10.0**decade, setup.intensity)
        noises = [
            _noise("process", i, problem.family.noises[i].name, intensity[i], unit[i] * 10.0**LOWEST_DECADE)
            for i in np.flatnonzero(setup.estimate_intensity).tolist()
        ]
        floor = FIT.smallest_std * np.maximum(residual_std, rough_std)
        noises += [
            _noise("measurement", j, problem.family.outputs[j].name, std[j], floor[j])
            for j in np.flatnonzero(setup.estimate_std).tolist()
        ]
        unknowns = Unknowns((*parameters, *noises), problem.unknowns.theta, intensity, std)
        trial = replace(problem, unknowns=unknowns, is_filtered=True)
        found = trial.predict(unknowns.start)
        if found is not None and (best is None or found.negative_log_likelihood < best[0]):
            best = (found.negative_log_likelihood, trial)
    return best[1] if best else trial


def _with_common_bounds(problems: Sequence[Problem]) -> Problem:
    """The first of some problems of `_with_noise`, whose noises may become as small as in any of them."""
    lowest = np.min([p.unknowns.lower for p in problems], axis=0)
    unknowns = problems[0].unknowns
    coordinates = tuple(
        c if c.kind == "parameter" else replace(c, lower=float(np.exp(low)))
        for c, low in zip(unknowns.coordinates, lowest, strict=True)
    )
    return replace(problems[0], unknowns=replace(unknowns, coordinates=coordinates))


def _noise(
    kind: Literal["process", "measurement"], index: int, name: str, value: float, lower: float
) -> Coordinate:
    return Coordinate(name, kind, index, max(value, lower), True, 1.0, lower, np.inf)


def _residual_sizes(problem: Problem, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """rms of the simulation residuals, and of their white part (from second differences), both (n_y,)."""
    free = replace(problem, weigh=np.ones(len(problem.family.outputs), dtype=bool))
    simulated = simulate(free, theta, np.ones(len(problem.family.outputs)))
    n_y = len(problem.family.outputs)
    total, rough = np.zeros(n_y), np.zeros(n_y)
    counts, triples = np.zeros(n_y), np.zeros(n_y)
    for i, record in enumerate(problem.records):
        seen = record.observed
        if simulated is None:
            residuals = record.outputs - record.outputs.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        else:
            found = simulated.found[i]
            residuals = found.at_zero - np.tensordot(simulated.initial_states[i], found.response, 1)
        total += np.sum((residuals * seen) ** 2, axis=0)
        counts += seen.sum(axis=0)
        together = seen[2:] & seen[1:-1] & seen[:-2]
        rough += np.sum(np.diff(residuals, 2, axis=0) ** 2 * together, axis=0) / 6.0
        triples += together.sum(axis=0)
    whole = np.sqrt(total / np.maximum(counts, 1))
    whole = np.where(whole > 0.0, whole, 1.0)
    fine = np.sqrt(rough / np.maximum(triples, 1))
    return whole, np.where((triples > 0) & (fine > 0.0), np.minimum(fine, whole), whole)


def _reference_intensities(problem: Problem, theta: np.ndarray, residual_std: np.ndarray) -> np.ndarray:
    """Intensity (n_w,) of each noise that alone would make outputs as wrong as the simulation residuals
    are.
    """
    ss = state_space(problem.family, theta)
    record = max(problem.records, key=lambda r: r.n_samples)
    period = record.period or float(np.mean(np.diff(record.time)))
    length = period * min(record.n_samples, LONGEST_GROWTH)
    result = np.ones(ss.G.shape[1])
    with np.errstate(all="ignore"):
        held = transition_integrals(ss.A, period).first
        for i, column in enumerate(ss.G.T):
            one = np.outer(column, column)
            grown = covariance_integral(ss.A, one, length)
            if not np.all(np.isfinite(grown)):
                grown = held @ one @ held.T / period
            direct = ss.H[:, i] ** 2 / period
            variance = np.einsum("ya,ab,yb->y", ss.C, grown, ss.C) + direct
            with_effect = variance > 0.0
            if np.any(with_effect):
                result[i] = np.min(residual_std[with_effect] ** 2 / variance[with_effect])
    return result


def _end_scores(problem: Problem, z: np.ndarray) -> tuple[list[Scores], Predicted]:
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


def _notes(problem: Problem, parts: list[Scores], uncertainty: Uncertainty) -> tuple[str, ...]:
    """What is to be said of the standard errors."""
    if uncertainty.is_coloured:
        return (COLOURED,)
    observed = [record.observed for record in problem.records]
    is_following = problem.is_filtered and are_coloured([s.residuals for s in parts], observed)
    return (FOLLOWING,) if is_following else ()


def _open_bound(coordinate: Coordinate, z: float, variance_z: float) -> Bound | None:
    """A logarithmic unknown whose likelihood does not fall towards zero counts as being at zero."""
    if not coordinate.is_log or (coordinate.kind == "parameter" and coordinate.lower > 0.0):
        return None
    unsure = not np.isfinite(variance_z) or variance_z > FIT.open_towards_zero**2
    fell = coordinate.kind != "parameter" or z < coordinate.searched(coordinate.initial)
    return "min" if unsure and fell else None


def _places(problem: Problem, kind: str) -> dict[int, int]:
    """Noise or output index -> position among the unknowns."""
    return {problem.unknowns.coordinates[i].index: i for i in problem.unknowns.of_kind(kind)}


def _process_noises(problem: Problem, intensity: np.ndarray, end: End) -> tuple[FittedNoise, ...]:
    searched, result = _places(problem, "process"), []
    for k, noise in enumerate(problem.family.noises):
        i = searched.get(k)
        error, bound = (None, None) if i is None else (end.errors[i], end.bounds[i])
        value = float(intensity[k])
        result.append(FittedNoise(noise.name, "process", value, error, noise.unit, i is not None, bound))
    return tuple(result)


def _measurement_noises(
    problem: Problem, estimated: np.ndarray, std: np.ndarray, end: End
) -> tuple[FittedNoise, ...]:
    """Noises of the measured outputs. One that was eliminated is a mean of n squares: std(σ) = σ / √(2 n)."""
    searched, result = _places(problem, "measurement"), []
    counts = observed_counts(problem.records)
    for j in np.flatnonzero(counts):
        output, value, i = problem.family.outputs[j], float(std[j]), searched.get(int(j))
        error = value / float(np.sqrt(2.0 * counts[j])) if estimated[j] else None
        bound = None
        if i is not None:
            error, bound = end.errors[i], end.bounds[i]
        result.append(
            FittedNoise(output.name, "measurement", value, error, output.unit, bool(estimated[j]), bound)
        )
    return tuple(result)


def _agreement(problem: Problem, predicted: Predicted | None) -> Agreement:
    """Of predictions with the recordings of `problem`; None: there are none."""
    errors = None
    if predicted is not None:
        parts = zip(problem.records, predicted.found, predicted.initial_states, strict=True)
        errors = [
            np.where(record.observed, part.at_zero - np.tensordot(x0, part.response, 1), np.nan)
            for record, part, x0 in parts
        ]
    measured = [np.where(record.observed, record.outputs, np.nan) for record in problem.records]
    return agreement_of(problem.family.output_names, measured, errors)
