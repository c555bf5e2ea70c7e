"""Identify: unknown parameters and noises of a linear DAE from recordings. Report (2), (3)-(8)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from typing import Literal

import numpy as np

from daest.errors import EstimationError
from daest.estimation.arx import matched_start
from daest.estimation.checks import check_bounds, check_jumps, check_records, check_start, known_name
from daest.estimation.coordinates import Unknowns, coordinate_with_prior, parameter_coordinate
from daest.estimation.ekf_likelihood import identify_by_ekf
from daest.estimation.gates import FIT
from daest.estimation.gaussian import objective
from daest.estimation.identify_nonlinear import identify_nonlinear
from daest.estimation.linear_predictors import Problem
from daest.estimation.noise_start import with_common_bounds, with_noise
from daest.estimation.optimum import Search, best_point, coloured, rank
from daest.estimation.profile import (
    Searched,
    Tell,
    check_profile_names,
    silent,
    with_interval_check,
    with_profiles,
)
from daest.estimation.records import Record, in_model_order, make_record, observed_counts, part_of
from daest.estimation.result import (
    end_scores,
    fit_result,
    predicted_agreement,
    simulated_agreement,
)
from daest.estimation.search import Evaluation, Found, minimise
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions, Method, NoiseChoice
from daest.model.flat import FlatModel, Model, events_refused
from daest.model.linear import StateSpaceFamily
from daest.model.prior import prior_unused
from daest.numerics.parallel import workers
from daest.systems.modes import in_starting_mode
from daest.systems.reduce import dynamics
from daest.systems.redundant import good_everywhere
from daest.systems.sample import Hold, slope_note
from daest.systems.state_space import state_space, state_space_family

HOLD_ITERATIONS = 10  # of the short output-error fits that compare the holds
HOLD_SAMPLES = 4000  # of every recording that this comparison uses
SIMULATION_ITERATIONS = 15  # of the output-error fit that a prediction-error fit starts from
START_SPREAD = np.log(10.0)  # further start points: up to a factor 10 off, for linear scales 3 scales off
LINEAR_SPREAD = 3.0
DOUBT_STARTS = 2  # random start points that are tried then
ENDS_ALIKE = 2  # of other starts: one may be led into the same wrong valley (1 of 200 random models)


@dataclass(frozen=True)
class Setup:
    """The problem before the search: output-error problem, the noises that exist, and what the user gave."""

    problem: Problem
    method: Method
    process: dict[int, bool]  # noise index -> estimated
    measurement: dict[int, bool]  # output index -> estimated
    given_intensity: np.ndarray
    given_std: np.ndarray
    notes: tuple[str, ...]


def identify(
    model: Model | StateSpaceFamily,
    experiments: Sequence[Experiment],
    options: IdentifyOptions | None = None,
    validation: Sequence[Experiment] = (),
    tell: Tell = silent,
) -> FitResult:
    """Find the parameters of `model` that explain `experiments`, with their uncertainty.

    "oe" minimises the simulation error (2), weighted by maximum likelihood; "pem" maximises the
    likelihood of the one-step predictions of the Kalman filter, process and measurement noise included.
    Default: "pem" for a model that declares process noise, else "oe". Initial states are estimated per
    experiment; those of validation records too. `tell` hears what is being done. Raises EstimationError
    (codes in `estimation.checks`, `jumps`, `priors` and `profile`) and DataError.
    """
    began = time.perf_counter()
    options = options or IdentifyOptions()
    if isinstance(model, FlatModel):
        check_jumps(model)
        model = in_starting_mode(model)
    family = model if isinstance(model, StateSpaceFamily) else state_space_family(model)
    estimation, held_back = _divided(tuple(experiments), tuple(validation), options.split)
    setup = _setup(family, tuple(make_record(e, family) for e in estimation), options)
    check_profile_names(options.profile, setup.problem.unknowns)
    if isinstance(model, Model) and model.events is not None and setup.method == "pem":
        raise events_refused("a prediction from sample to sample")
    if isinstance(model, Model) and (model.events is not None or not family.is_affine):
        return _identified_nonlinear(model, family, setup, estimation, held_back, options, tell)
    setup = replace(setup, problem=replace(setup.problem, hold=_chosen_hold(setup, options)))
    _check_start(setup)
    problem, ends = _search(setup, options, tell)
    validation_records = tuple(make_record(e, family) for e in held_back)
    simulated = {"estimation": simulated_agreement(problem, problem.records, ends[0].z)}
    agree = predicted_agreement if problem.is_filtered else simulated_agreement
    one_step = {"estimation": agree(problem, problem.records, ends[0].z)}
    if validation_records:
        simulated["validation"] = simulated_agreement(problem, validation_records, ends[0].z)
        one_step["validation"] = agree(problem, validation_records, ends[0].z)
    result = fit_result(problem, setup.method, ends, setup.measurement, simulated, one_step, setup.notes)
    initial = {c.name: c.initial for c in setup.problem.unknowns.coordinates}
    parameters = tuple(replace(p, initial=initial[p.name]) for p in result.parameters)
    result = replace(result, parameters=parameters)
    if options.shooting:
        note = "no multiple shooting: the initial states of a linear model are eliminated exactly"
        result = replace(result, notes=(*result.notes, note))
    unknowns = problem.unknowns
    searched = Searched(objective(problem), unknowns, unknowns.lower, unknowns.upper, ends[0])
    if options.second_look:
        result = with_interval_check(result, searched)
    if options.profile:
        result = with_profiles(result, searched, options.profile, tell)
    return replace(result, seconds=time.perf_counter() - began)


def _identified_nonlinear(
    flat: Model,
    family: StateSpaceFamily,
    setup: Setup,
    estimation: tuple[Experiment, ...],
    validation: tuple[Experiment, ...],
    options: IdentifyOptions,
    tell: Tell,
) -> FitResult:
    n_w, n_y = len(family.noises), len(family.outputs)
    estimated = np.array([setup.process[i] for i in range(n_w)], dtype=bool)
    searched = np.array([setup.measurement[j] for j in range(n_y)], dtype=bool)
    explicit = dynamics(flat)
    explicit = explicit if flat.events is not None else good_everywhere(explicit)
    # States that constraints tie have no observer with a constant gain.
    by_ekf = setup.method == "pem" and (options.likelihood == "ekf" or explicit.invariants is not None)
    search = identify_by_ekf if by_ekf else identify_nonlinear
    result = search(
        explicit,
        setup.problem.unknowns,
        [in_model_order(e, family) for e in estimation],
        setup.method,
        setup.given_intensity,
        estimated,
        np.where(searched, np.nan, setup.given_std),
        options,
        [in_model_order(e, family) for e in validation],
        tell=tell,
    )
    return replace(result, notes=(*result.notes, *_hold_note(family, options)))


def _divided(
    experiments: tuple[Experiment, ...], validation: tuple[Experiment, ...], split: float | None
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:
    """Estimation and validation records; error `split-out-of-range`."""
    if split is None:
        return experiments, validation
    if not 0.0 < split < 1.0:
        raise EstimationError(
            "split-out-of-range",
            f"the split {split:g} leaves nothing to estimate from or nothing to validate with",
            remedy="give a number between 0 and 1",
        )
    cuts = [max(1, round(split * e.n_samples)) for e in experiments]
    first = tuple(part_of(e, 0, cut) for e, cut in zip(experiments, cuts, strict=True))
    rest = tuple(part_of(e, cut, e.n_samples) for e, cut in zip(experiments, cuts, strict=True))
    return first, (*rest, *validation)


def _setup(family: StateSpaceFamily, records: tuple[Record, ...], options: IdentifyOptions) -> Setup:
    theta, unknowns = _unknowns(family, options)
    process, intensity = _noise_choices(
        [n.name for n in family.noises],
        [NoiseChoice(n.intensity, n.estimate or n.intensity is None) for n in family.noises],
        options.process_noise,
        "noise",
    )
    measurement, std = _noise_choices(
        [o.name for o in family.outputs],
        [NoiseChoice(o.noise_std, o.estimate_noise or o.noise_std is None) for o in family.outputs],
        options.measurement_noise,
        "output",
    )
    method: Method = options.method or ("pem" if family.noises else "oe")
    measured = observed_counts(records) > 0 if records else np.zeros(len(family.outputs), dtype=bool)
    measurement = {j: choice and bool(measured[j]) for j, choice in measurement.items()}
    std = np.where(measured, std, np.where(np.isnan(std), 1.0, std))
    n_noises = sum(measurement.values()) + (sum(process.values()) if method == "pem" else 0)
    check_records(family, records, len(unknowns.coordinates) + n_noises)
    weigh = np.array([measurement[j] for j in range(len(family.outputs))], dtype=bool)
    notes = [] if family.is_affine else ["the model is nonlinear: its linearisation was identified"]
    notes += _hold_note(family, options)
    notes += [
        f"output {o.name} has no measured value"
        for o, m in zip(family.outputs, measured, strict=True)
        if not m
    ]
    given = Unknowns(
        unknowns.coordinates, theta, np.zeros(len(family.noises)), np.where(np.isnan(std), 1.0, std)
    )
    has_direct_noise = bool(np.any(state_space(family, theta).H != 0.0))
    sampled: Literal["white", "held"] = "held" if has_direct_noise else "white"
    problem = Problem(family, records, "foh", given, weigh, sampled)
    return Setup(problem, method, process, measurement, intensity, std, tuple(notes))


def _hold_note(family: StateSpaceFamily, options: IdentifyOptions) -> tuple[str, ...]:
    if options.hold is not None:
        return ()
    return slope_note([v.name for v in family.inputs], [i for i, _ in family.input_derivatives])


def _unknowns(family: StateSpaceFamily, options: IdentifyOptions) -> tuple[np.ndarray, Unknowns]:
    """All parameter values (fixed and start values put in), and the coordinates of the unknown ones."""
    known = [p.name for p in family.parameters]
    theta = np.array([p.value for p in family.parameters], dtype=float)
    for name, value in {**options.start, **options.fix}.items():
        theta[known_name(name, known, "parameter")] = value
    for name in options.bounds:
        known_name(name, known, "parameter")
    names = options.estimate
    if names is None:
        names = tuple(p.name for p in family.parameters if p.estimate)
    names = tuple(n for n in names if n not in options.fix)
    for name in options.prior:
        known_name(name, known, "parameter")
        if name not in names:
            raise prior_unused(name)
    indices = [known_name(n, known, "parameter") for n in names]
    if not names:
        raise EstimationError(
            "identify-nothing-to-estimate",
            "no parameter is marked as unknown",
            remedy="mark it in the model (__Daest(estimate = true)) or in daest.toml ([parameters] "
            "NAME = { estimate = true }), or name it (--estimate NAME)",
        )
    coordinates = []
    for name, index in zip(names, indices, strict=True):
        parameter = family.parameters[index]
        bounds = options.bounds.get(name, (parameter.min, parameter.max))
        coordinate = parameter_coordinate(family, name, float(theta[index]), bounds)
        check_bounds(coordinate)
        coordinates.append(coordinate_with_prior(coordinate, options.prior.get(name, parameter.prior)))
    return theta, Unknowns(tuple(coordinates), theta, np.zeros(0), np.zeros(0))


def _noise_choices(
    names: list[str], defaults: list[NoiseChoice], given: object, what: str
) -> tuple[dict[int, bool], np.ndarray]:
    """index -> estimated, and the values (NaN where unknown), of the model overruled by the options."""
    choices = list(defaults)
    for name, choice in dict(given).items():  # type: ignore[call-overload]
        i = known_name(name, names, what)
        value = defaults[i].value if choice.value is None else choice.value
        estimate = defaults[i].estimate if choice.estimate is None else choice.estimate
        choices[i] = NoiseChoice(value, bool(estimate) or value is None)
    values = np.array([np.nan if c.value is None else c.value for c in choices], dtype=float)
    return {i: bool(c.estimate) for i, c in enumerate(choices)}, values


def _chosen_hold(setup: Setup, options: IdentifyOptions) -> Hold:
    """The given hold, or the one with the higher likelihood after short output-error fits."""
    family = setup.problem.family
    if options.hold is not None:
        return options.hold
    if family.input_derivatives or not family.inputs:
        return "foh"
    short = replace(setup.problem, records=tuple(_head(r, HOLD_SAMPLES) for r in setup.problem.records))
    unknowns = short.unknowns
    z, values = unknowns.start, {}
    for hold in ("foh", "zoh"):
        found = minimise(
            objective(replace(short, hold=hold)), z, unknowns.lower, unknowns.upper, HOLD_ITERATIONS
        )
        if found is None:
            return "foh"
        z, values[hold] = found.z, found.evaluation.value
    return "zoh" if values["zoh"] < values["foh"] else "foh"


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


def _check_start(setup: Setup) -> None:
    problem = setup.problem
    start: Evaluation | None = objective(problem)(problem.unknowns.start, True)
    if start is None and setup.method == "pem":
        noisy = _noisy(setup, problem.unknowns.start)
        whole = objective(noisy)(noisy.unknowns.start, True)
        p = len(problem.unknowns.coordinates)
        if whole is not None:
            start = Evaluation(whole.value, whole.gradient[:p], whole.information[:p, :p])
    check_start(problem.unknowns, start, int(observed_counts(problem.records).sum()))


def _noisy(setup: Setup, z: np.ndarray) -> Problem:
    return with_noise(
        setup.problem, setup.process, setup.measurement, setup.given_intensity, setup.given_std, z
    )


def _search(setup: Setup, options: IdentifyOptions, tell: Tell) -> tuple[Problem, list[Found]]:
    """The problem that was searched, and the end of the search from every start, best first.

    In doubt, other starts are tried until one leaves white residuals, or ENDS_ALIKE of them end where the
    first one did: then it is the model that leaves them coloured.
    """
    began = time.perf_counter()
    unknowns = setup.problem.unknowns
    first = _simulated_from(setup, unknowns.start, options.max_iterations)
    pairs = [_search_from(setup, unknowns.start, first, options.max_iterations)]
    seconds = time.perf_counter() - began
    if options.starts > 1:
        pairs += _from_other_starts(setup, first, pairs[0], options, seconds, tell)
    elif options.second_look and options.max_iterations:
        for level, start in _second_looks(setup, options):
            alike = sum(_ends_alike(pairs[0], pair) for pair in pairs[1:])
            if not _is_doubtful(setup, pairs[-1], level) or alike >= ENDS_ALIKE:
                break
            z = start()
            if z is not None:
                end = _other_end(setup, first, options.max_iterations, z)
                pairs.append(pairs[0] if isinstance(end, _Same) else end)
    ended = [pair for pair in pairs if pair is not None]
    if not ended:
        check_start(unknowns, None, 0)
    ended.sort(key=lambda pair: rank(pair[1]))
    return ended[0][0], [found for _, found in ended]


class _Same:
    """In place of an end: the search led to where the first one did."""


End = tuple[Problem, Found] | None


def _other_starts(setup: Setup, options: IdentifyOptions) -> list[np.ndarray]:
    matched = matched_start(setup.problem, options.seed)
    random = _random_starts(setup.problem.unknowns, options.starts - 1, options.seed)
    return [*([] if matched is None else [matched]), *random]


def _second_looks(
    setup: Setup, options: IdentifyOptions
) -> Iterator[tuple[float, Callable[[], np.ndarray | None]]]:
    """Levels of the doubt that makes another start worth trying, and the start: one that matches ARX models
    where anything is suspicious, random ones where the residuals are not white."""
    yield FIT.suspicious_level, lambda: matched_start(setup.problem, options.seed)
    for z in _random_starts(setup.problem.unknowns, DOUBT_STARTS, options.seed):
        yield FIT.random_start_level, partial(np.asarray, z)


def _from_other_starts(
    setup: Setup, first: Found | None, end: End, options: IdentifyOptions, seconds: float, tell: Tell
) -> list[End]:
    starts = _other_starts(setup, options)
    search = partial(_other_end, setup, first, options.max_iterations)
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


def _other_end(setup: Setup, first: Found | None, max_iterations: int, z: np.ndarray) -> End | _Same:
    simulated = _simulated_from(setup, z, max_iterations)
    # The same simulation leads on to the same likelihood.
    return _Same() if _is_same(first, simulated) else _search_from(setup, z, simulated, max_iterations)


def _is_same(one: Found | None, other: Found | None) -> bool:
    if one is None or other is None:
        return False
    return abs(one.evaluation.value - other.evaluation.value) < FIT.same_simulation


def _ends_alike(one: tuple[Problem, Found] | None, other: tuple[Problem, Found] | None) -> bool:
    if one is None or other is None:
        return False
    return abs(one[1].evaluation.value - other[1].evaluation.value) < FIT.same_optimum


def _simulated_from(setup: Setup, z: np.ndarray, max_iterations: int) -> Found | None:
    """The end of the output-error search: the whole search, or where that of the likelihood begins."""
    simulation, unknowns = objective(setup.problem), setup.problem.unknowns
    if setup.method == "oe":
        search = Search(simulation, unknowns, unknowns.lower, unknowns.upper, unknowns.start, max_iterations)
        return best_point(search, [z])
    return minimise(simulation, z, unknowns.lower, unknowns.upper, SIMULATION_ITERATIONS)


def _search_from(
    setup: Setup, z: np.ndarray, simulated: Found | None, max_iterations: int
) -> tuple[Problem, Found] | None:
    """The end of the search from z. Process noise biases what a simulation ends at, or leads it astray: the
    likelihood is searched both from there and from z itself."""
    if setup.method == "oe":
        return None if simulated is None else (setup.problem, simulated)
    starts = [_noisy(setup, start) for start in ([] if simulated is None else [simulated.z]) + [z]]
    noisy = with_common_bounds(starts)
    unknowns = noisy.unknowns
    home = np.concatenate([setup.problem.unknowns.start, unknowns.start[setup.problem.unknowns.start.size :]])
    search = Search(objective(noisy), unknowns, unknowns.lower, unknowns.upper, home, max_iterations)

    def is_doubtful(found: Found) -> bool:
        return _is_doubtful(setup, (noisy, found), FIT.suspicious_level)

    found = best_point(search, [start.unknowns.start for start in starts], is_doubtful)
    return None if found is None else (noisy, found)


def _random_starts(unknowns: Unknowns, count: int, seed: int) -> list[np.ndarray]:
    """Random points: within the bounds where both are finite, else around the start."""
    rng = np.random.default_rng(seed)
    lower, upper, start = unknowns.lower, unknowns.upper, unknowns.start
    spread = np.array([START_SPREAD if c.is_log else LINEAR_SPREAD for c in unknowns.coordinates])
    bounded = np.isfinite(lower) & np.isfinite(upper)
    low = np.where(bounded, lower, np.maximum(start - spread, lower))
    high = np.where(bounded, upper, np.minimum(start + spread, upper))
    return [rng.uniform(low, high) for _ in range(count)]


def _is_doubtful(setup: Setup, pair: tuple[Problem, Found] | None, level: float) -> bool:
    """Whether a better optimum may exist than the end of a search: its residuals are not white at that
    level, or the level is that of a suspicion and the search did not converge."""
    if pair is None or (level == FIT.suspicious_level and pair[1].reason != "converged"):
        return True
    return _is_coloured(setup, pair, level)


def _is_coloured(setup: Setup, pair: tuple[Problem, Found], level: float) -> bool:
    """Whether the residuals at the end of a search are not white."""
    problem, found = pair
    parts, _ = end_scores(problem, found.z)
    return coloured([part.residuals for part in parts], [r.observed for r in problem.records], level)
