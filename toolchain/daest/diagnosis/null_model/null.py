"""The null hypothesis: the model as it is, fitted by maximum likelihood with measurement noise and coloured
loads at the places where the model admits them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.loads import LoadPlace, load_places, with_loads
from daest.errors import DaestError, EstimationError
from daest.estimation.fitting.coordinates import Unknowns, parameter_coordinate
from daest.estimation.fitting.records import longest_duration
from daest.estimation.gates import FIT
from daest.estimation.identify import identify
from daest.estimation.linear.hold_search import are_steps, moving_inputs, possible_holds, ranked_holds
from daest.estimation.nonlinear.identify_nonlinear import Refit, WarmStart, search_on
from daest.model.diagnosis import Load
from daest.model.effects import Site
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import ExplicitModel, FlatModel
from daest.model.holds import FOH, HOLDS, SMOOTH, ZOH, Hold, held_inputs
from daest.model.parts import Parameter, Prior
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.linear.state_space import family_along, state_space
from daest.systems.reduction.input_slopes import acting_slopes
from daest.systems.reduction.reduce import reduce_index

FIRST_LOAD = 20.0  # sampling periods, start of the search
FASTER_LOAD = 2.1  # and of a second one, where the model is not linear: hardly more than white noise
GIVEN_LOADS = (5.0, 50.0)  # sampling periods, where the data do not determine a time constant


@dataclass(frozen=True)
class Null:
    """`flat` is the model with the loads attached and all values at the estimate; `fit` the fit of that
    model. `other_hold` is that of the inputs which the user has not ruled out, and fits worse by `hold_lead`
    in log-likelihood; `other_fit` is the whole fit with it, None where it is not one of the same experiments,
    and `other_experiments` are those for it where the experiments are coarser than the recordings, and their
    inputs straight lines either way. `recorded_hold` is that of the recordings, and
    `is_hold_given` whether the user says so. No time constant of a load is above `slowest` [s]; None: the
    length of the record limits it. `alone` is the fit by simulation without loads, None where it was not
    asked for, and `is_upright` tells that it is one in segments of a machine that falls over."""

    flat: FlatModel
    explicit: ExplicitModel
    fit: FitResult
    loads: tuple[Load, ...]
    places: tuple[LoadPlace, ...]
    experiments: tuple[Experiment, ...]
    hold: Hold
    other_hold: Hold | None = None
    hold_lead: float = 0.0
    other_fit: FitResult | None = None
    other_experiments: tuple[Experiment, ...] | None = None
    recorded_hold: Hold | None = None
    slowest: float | None = None
    is_hold_given: bool = False
    alone: FitResult | None = None
    is_upright: bool = False

    @property
    def is_likelier_alone(self) -> bool:
        """Whether a simulation without loads is likelier than what is predicted beside them. What falls over
        cannot be left alone by an observer: there loads of next to nothing do what initial states do."""
        if self.alone is None or not self.is_upright:
            return False
        return self.alone.log_likelihood >= self.fit.log_likelihood

    @property
    def estimated(self) -> tuple[str, ...]:
        """The physical parameters that are estimated."""
        times = {place.time_constant for place in self.places}
        return tuple(p.name for p in self.fit.parameters if p.name not in times)

    @property
    def intensity(self) -> np.ndarray:
        """Of all white noises of `flat`, (n_w,)."""
        found = {n.name: n.value for n in self.fit.noises if n.kind == "process"}
        return np.array([found.get(w.name, 0.0) for w in self.flat.noises])

    @property
    def shortest_times(self) -> dict[str, float]:
        """The time constants of the loads [s] by name of the parameter, as short as a load can have them:
        loads without memory."""
        return {place.time_constant: shortest_load(self.experiments) for place in self.places}

    @property
    def measurement_std(self) -> np.ndarray:
        """Standard deviation (n_y,) of every output's noise in its unit, 1 where none was estimated."""
        found = {n.name: n.value for n in self.fit.noises if n.kind == "measurement"}
        return np.array([found.get(o.name, 1.0) for o in self.flat.outputs])

    @property
    def starting_std(self) -> np.ndarray:
        """That noise (n_y,), from which the search of a similar model begins: no less than a share of what
        the output does. A load that reaches an output at once may have taken all of its noise, and no search
        comes back from none when the load is gone."""
        whole = np.vstack([e.outputs for e in self.experiments])
        return np.maximum(self.measurement_std, GATES.least_noise * np.nan_to_num(np.nanstd(whole, axis=0)))

    @property
    def initial_states(self) -> tuple[dict[str, float], ...]:
        """Of every experiment, by state name."""
        return tuple(
            {name: float(x) for name, x in zip(s.names, s.values, strict=True)}
            for s in self.fit.initial_states
        )

    @property
    def theta(self) -> np.ndarray:
        return self.flat.theta_values


def fit_null(
    flat: FlatModel,
    nodes: Sequence[Site],
    experiments: Sequence[Experiment],
    hold: Hold | None,
    held: Sequence[Experiment] | None = None,
    slowest: float | None = None,
    near: Mapping[str, float] | None = None,
    known: FitResult | None = None,
) -> Null:
    """Fit the null to the experiments; to those `held`, if they are given, where the inputs of the recordings
    were. The parameters that `flat` marks are estimated. `slowest` [s] limits the time constants of loads.
    The search begins `near` values that are known, as those with the other hold (`known_values`); with the
    hold of a `known` fit of the same unknowns (`other_fit`), that fit is taken.

    Without `hold`, the only possible or the more likely one is taken: the loads must be there when the holds
    are compared, for half a sample of delay is little beside a load, but a finding once the load is
    explained. What is missing bends the likelihood of both; so the other hold is kept in mind until something
    is found.

    A load that buys no likelihood has size 0 in the end. Raises what `identify` raises, and EstimationError
    `diagnose-no-place` when no load would show in the outputs.
    """
    flat = near_given(flat)
    places = load_places(flat, nodes) or load_places(under_recorded_inputs(flat, experiments), nodes)
    if not places:
        raise _no_place(flat, nodes)
    period = period_of(experiments)
    loaded = with_loads(flat, places, [FIRST_LOAD * period] * len(places))
    explicit = reduce_index(loaded)
    names = moving_inputs(experiments, flat.input_names)
    asked = (hold,) if hold else _asked_holds(explicit, experiments, held, names)
    is_affine = has_affine_dynamics(explicit)
    times = tuple(place.time_constant for place in places)
    fits: dict[Hold, FitResult] = {}

    def driving_by(one: Hold) -> tuple[Sequence[Experiment], Hold]:
        return (experiments, one) if held is None else (as_recorded(experiments, held, one), FOH)

    alone = _Alone(flat, driving_by)
    is_held = not near and not is_affine and falls_over(explicit, experiments)
    upright = alone.upright(asked) if is_held else None
    unknown = {*times, *(p.name for p in flat.parameters if p.estimate)}
    if known is not None and unknown == {p.name for p in known.parameters}:
        fits[known.hold] = known
    if upright is not None:
        asked, near = upright.holds, known_values(upright.fit)

    def likelihood(one: Hold) -> float:
        if one in fits:
            return fits[one].log_likelihood
        driving = driving_by(one)
        # The holds differ by half a sample: the second search begins where the first one has ended.
        led = known_values(max(fits.values(), key=lambda fit: fit.log_likelihood, default=None))
        begun = _Begun(near or led, is_simulated=upright is not None)
        fits[one] = _loaded_fit(loaded, times, *driving, slowest, is_affine, begun)
        back = {} if near else alone.values_near(one, fits[one])
        if back:
            afresh = _loaded_fit(loaded, times, *driving, slowest, is_affine, _Begun(back))
            fits[one] = max(fits[one], afresh, key=lambda fit: fit.log_likelihood)
        return fits[one].log_likelihood

    turned = names if len(asked) > 1 else ()
    best, *others = ranked_holds(turned, likelihood, asked, are_steps(held or experiments, names))
    # Straight lines and smooth curves hardly differ: held inputs are the other answer to either of them.
    others = [hold for hold in others if {best, hold} != {FOH, SMOOTH}] or others
    null = _at_estimate(loaded, fits[best], places, as_recorded(experiments, held, best))
    null = replace(null, recorded_hold=best, slowest=slowest)
    null = replace(null, alone=alone.found.get(best), is_upright=upright is not None)
    if not others:
        return null
    lead = fits[best].log_likelihood - fits[others[0]].log_likelihood
    apart = None if held is None else as_recorded(experiments, held, others[0])
    is_alike = held is None and upright is None
    return replace(
        null,
        other_hold=others[0],
        hold_lead=lead,
        other_fit=fits[others[0]] if is_alike else None,
        other_experiments=apart,
    )


def are_driven_off(found: Mapping[str, float], given: Mapping[str, float]) -> bool:
    """Whether any parameter was `found` so far from its `given` value that something else drives it."""
    return farthest(found, given) >= GATES.driven_off


def farthest(found: Mapping[str, float], given: Mapping[str, float]) -> float:
    """The largest ratio, above 1, of a parameter as it was `found` to its `given` value, either way; inf
    where one has the other sign, or is nothing."""
    ratios = [found[name] / value for name, value in given.items() if value and name in found]
    return max((max(one, 1.0 / one) if one > 0.0 else np.inf for one in ratios), default=1.0)


def are_elsewhere(one: Mapping[str, float], other: Mapping[str, float], names: Collection[str]) -> bool:
    """Whether any of the parameters `names` is another one by far, in its size."""
    pairs = [(one[n], other[n]) for n in names if n in one and n in other]
    return any(a * b > 0.0 and abs(np.log(a / b)) > np.log(GATES.elsewhere) for a, b in pairs)


def falls_over(explicit: ExplicitModel, experiments: Sequence[Experiment]) -> bool:
    """Whether the model, left alone at its values, goes so far from where it is within a record that no
    simulation follows it: a pendulum that a controller holds upright."""
    with suppress(DaestError):
        family = family_along(explicit)
        return grows_beyond(state_space(family, explicit.flat.theta_values).A, experiments)
    return False


def grows_beyond(A: np.ndarray, experiments: Sequence[Experiment]) -> bool:
    """Whether an error of x' = A x, A of (n, n), grows beyond all measure within a record."""
    if not np.all(np.isfinite(A)):
        return False
    fastest = float(np.max(np.linalg.eigvals(A).real, initial=0.0))
    return fastest * longest_duration(experiments) > GATES.falls_over


@dataclass(frozen=True)
class _Upright:
    """The `fit` by simulation in segments of a machine that falls over, and the `holds` that are not clearly
    refused by it."""

    fit: FitResult
    holds: tuple[Hold, ...]


@dataclass(frozen=True)
class _Alone:
    """The fits by simulation of the model `flat` without loads, of each hold once: of the recordings, and the
    hold, that an answer to how the inputs were held is `driving` with. None where a fit came to no end."""

    flat: FlatModel
    driving: Callable[[Hold], tuple[Sequence[Experiment], Hold]]
    found: dict[Hold, FitResult | None] = field(default_factory=dict)

    def fit(self, one: Hold) -> FitResult | None:
        if one not in self.found:
            self.found[one] = None
            experiments, hold = self.driving(one)
            with suppress(EstimationError):
                self.found[one] = identify(self.flat, experiments, IdentifyOptions(method="oe", hold=hold))
        return self.found[one]

    def upright(self, asked: Sequence[Hold]) -> _Upright | None:
        """The simulation of a machine that falls over, with the likeliest of the holds; None where it came to
        no end. Loads hold up what falls over whatever its parameters are: their likelihood has hills
        everywhere."""
        fits = {one: fit for one in asked if (fit := self.fit(one)) is not None}
        best = max(fits.values(), key=lambda fit: fit.log_likelihood, default=None)
        if best is None or not known_values(best):
            return None
        least = best.log_likelihood - GATES.clear_hold_gain
        refused = {one for one, fit in fits.items() if fit.log_likelihood <= least}
        return _Upright(best, tuple(one for one in asked if one not in refused))

    def values_near(self, one: Hold, beside: FitResult) -> dict[str, float]:
        """The parameters near their given values to which the simulation leads, where the fit `beside` loads
        has driven them off; none where they are off without loads, too. Loads hold up a pendulum that its
        controller balances, whatever it weighs."""
        given = {p.name: p.value for p in self.flat.parameters if p.estimate}
        if not are_driven_off(beside.theta, given):
            return {}
        values = known_values(self.fit(one))
        return {} if are_driven_off(values, given) else values


@dataclass(frozen=True)
class _Begun:
    """Where the search of a null begins, at other `values` than those of the user; `is_simulated`: at those
    to which the simulation of the model without loads has led."""

    values: Mapping[str, float]
    is_simulated: bool = False


def known_values(fit: FitResult | None) -> dict[str, float]:
    """The parameters at the end of a fit, from which that of a similar model may begin; none of a fit that
    came to no end. What rests at a bound is left out: a search that begins there may not leave it."""
    if fit is None or fit.status != "converged":
        return {}
    resting = {p.name for p in fit.parameters if p.at_bound}
    return {name: value for name, value in fit.theta.items() if name not in resting}


def as_recorded(
    experiments: Sequence[Experiment], held: Sequence[Experiment] | None, hold: Hold
) -> tuple[Experiment, ...]:
    """The experiments with the inputs that `hold` keeps as those `held` have them."""
    if held is None or hold in HOLDS:
        return tuple(held if held is not None and hold == ZOH else experiments)
    return tuple(
        replace(one, inputs=np.where(held_inputs(hold, one.input_names), other.inputs, one.inputs))
        for one, other in zip(experiments, held, strict=True)
    )


def slowest_load(
    flat: FlatModel, nodes: Sequence[Site], experiments: Sequence[Experiment], hold: Hold | None
) -> float:
    """The least limit [s] for the time constants of the loads with which the experiments are as likely as
    without one. Raises as `fit_null`."""
    free = fit_null(flat, nodes, experiments, hold)
    _, longest = _time_constants(experiments)
    for periods in GIVEN_LOADS:
        limit = min(periods * period_of(experiments), longest)
        fit = fit_null(flat, nodes, experiments, free.hold, slowest=limit).fit
        if fit.log_likelihood > free.fit.log_likelihood - GATES.min_load_gain:
            return limit
    return longest


def under_recorded_inputs(flat: FlatModel, experiments: Sequence[Experiment]) -> FlatModel:
    """The model whose inputs start at the medians of what is recorded of them. At rest, where they are zero,
    a model may have no finite rate, or nothing that an output sees: a tyre on a drum that stands."""
    recorded = np.nanmedian(np.concatenate([e.inputs for e in experiments]), axis=0)
    medians = dict(zip(experiments[0].input_names, recorded.tolist(), strict=True))
    return replace(
        flat,
        inputs=tuple(
            replace(v, start=medians[v.name]) if np.isfinite(medians.get(v.name, np.nan)) else v
            for v in flat.inputs
        ),
    )


def near_given(flat: FlatModel) -> FlatModel:
    """The model with its logarithmic parameters near the given values where the data leave them open.

    Loads make much of a model uncertain: a small inertia with its spring and its damper may shrink together
    to nothing and gain half a log-likelihood by it, and every effect there shrinks with them. What the data
    know at all is not moved by a prior as wide as this."""
    return replace(
        flat,
        parameters=tuple(
            replace(p, prior=Prior(p.value, GATES.given_spread * p.value)) if _is_open(p) else p
            for p in flat.parameters
        ),
    )


def _is_open(parameter: Parameter) -> bool:
    """Whether a parameter is estimated on a logarithmic scale and nothing is said of it beforehand."""
    is_log = parameter.scale == "log" or (
        parameter.scale == "auto" and parameter.min is not None and parameter.min >= 0.0
    )
    return parameter.estimate and parameter.prior is None and is_log and parameter.value > 0.0


def with_noise(null: Null, intensity: np.ndarray, std: np.ndarray) -> Null:
    """The null, not fitted again, with white noises of that `intensity` (n_w,) and sensors of that `std`
    (n_y,)."""
    process = dict(zip(null.flat.noise_names, intensity.tolist(), strict=True))
    measured = dict(zip(null.flat.output_names, std.tolist(), strict=True))
    noises = tuple(
        replace(n, value=(process if n.kind == "process" else measured).get(n.name, n.value))
        for n in null.fit.noises
    )
    return replace(null, fit=replace(null.fit, noises=noises))


def with_other_hold(null: Null) -> Null:
    """The null, not fitted again, with the other hold of the inputs of the recordings."""
    assert null.other_hold is not None
    if null.other_experiments is None:
        return replace(null, hold=null.other_hold, recorded_hold=null.other_hold)
    return replace(null, experiments=null.other_experiments, recorded_hold=null.other_hold)


def open_hold(null: Null, gain: float = 0.0) -> Hold | None:
    """The other hold of the inputs, unless the data have clearly refused it: by more than an effect gains
    that was missing when they did, for half a sample of delay is what such an effect may look like."""
    return null.other_hold if null.hold_lead < max(GATES.clear_hold_gain, gain) else None


def open_inputs(null: Null, gain: float) -> tuple[str, ...]:
    """The moving inputs whose hold is open, now that an effect that gains `gain` in log-likelihood is in the
    model: beside what was missing, that of an input that moves the machine little could not be told. None
    where the user says what it is, the experiments are coarser than the recordings, or slopes drive the
    model."""
    is_known = null.is_hold_given or null.other_experiments is not None or null.hold == SMOOTH
    if is_known or acting_slopes(null.explicit):
        return ()
    names = moving_inputs(null.experiments, null.flat.input_names)
    return () if len(names) == 1 and open_hold(null, gain) is None else names


def _asked_holds(
    explicit: ExplicitModel,
    experiments: Sequence[Experiment],
    held: Sequence[Experiment] | None,
    names: Sequence[str],
) -> tuple[Hold, ...]:
    """The holds of all inputs alike to choose from; one where no input moves."""
    if not names:
        return (FOH,)
    if held is not None:
        return HOLDS
    return possible_holds(experiments, names, bool(acting_slopes(explicit)))


def period_of(experiments: Sequence[Experiment]) -> float:
    """Sampling period [s]."""
    return experiments[0].median_step


def shortest_load(experiments: Sequence[Experiment]) -> float:
    """Time constant [s] of a load that is white noise to these samples."""
    return GATES.shortest_load * period_of(experiments)


def without_memory(experiments: Sequence[Experiment]) -> float:
    """A limit for the time constants of loads [s], beside which their starts say nothing of a recording."""
    return GIVEN_LOADS[0] * period_of(experiments)


def _time_constants(experiments: Sequence[Experiment], slowest: float | None = None) -> tuple[float, float]:
    """The shortest and the longest that a load can have [s]."""
    duration = float(sum(e.time[-1] - e.time[0] for e in experiments))
    longest = GATES.longest_load * duration
    return shortest_load(experiments), longest if slowest is None else min(slowest, longest)


def slowest_at(null: Null, places: Sequence[str]) -> float | None:
    """The time constant [s] of the load at one of the `places`, where it is the longest that a load can have:
    the data would have it slower still. None where it is not."""
    _, longest = _time_constants(null.experiments, null.slowest)
    there = [load.time_constant for load in null.loads if not {load.place, *load.places}.isdisjoint(places)]
    return longest if there and min(there) >= (1.0 - FIT.at_bound) * longest else None


def _no_place(flat: FlatModel, nodes: Sequence[Site]) -> EstimationError:
    if not nodes and not reduce_index(flat).state_names:
        return EstimationError(
            "diagnose-no-place",
            "the model has neither connectors nor states: its outputs follow from the inputs, and from rates "
            "of them, at once, by equations in which an unknown force, torque, current or flow has no place",
            remedy="build it from components, as a source, a Damper and a sensor of force; loads act at "
            "their connectors",
        )
    if not nodes:
        return EstimationError(
            "diagnose-no-place",
            "the model has neither connectors nor bare equations whose variables tell a physical domain that "
            "the library knows by their unit: there is no place where something could be missing",
            remedy='declare units, as in Real w(unit = "rad/s"), or build the model from components',
        )
    return EstimationError(
        "diagnose-no-place",
        "no force, torque, current or flow that acted on the model would show in its outputs",
        remedy="measure an output that the model moves; `daest noise` shows where a load is admissible",
    )


def _loaded_fit(
    loaded: FlatModel,
    times: tuple[str, ...],
    experiments: Sequence[Experiment],
    hold: Hold,
    slowest: float | None,
    is_affine: bool,
    begun: _Begun,
) -> FitResult:
    """The fit with the time constants `times` of the loads; where the start values are a point at which
    parameters do the same, as those of two equal tanks in a row do, from start values beside it. The
    search begins at the values `begun`, which tell nothing of what the user gave."""
    if begun.values:
        with suppress(EstimationError):
            there = _begun_at(loaded, times, begun.values)
            fit = _fit_from(there, times, experiments, hold, slowest, is_affine, begun.is_simulated)
            given = {p.name: p.value for p in loaded.parameters}
            return replace(fit, parameters=tuple(replace(p, initial=given[p.name]) for p in fit.parameters))
    try:
        return _fit_from(loaded, times, experiments, hold, slowest, is_affine)
    except EstimationError as error:
        if error.code != "identify-unidentifiable" or _is_about(error, times):
            raise
        try:
            return _fit_from(moved_apart(loaded), times, experiments, hold, slowest, is_affine)
        except EstimationError:
            raise error from None


def _begun_at(flat: FlatModel, times: tuple[str, ...], begun: Mapping[str, float]) -> FlatModel:
    """The model with its estimated parameters and the time constants `times` at the values `begun`, as far as
    they are known."""
    return replace(
        flat,
        parameters=tuple(
            replace(p, value=_inside(p, begun.get(p.name, p.value))) if p.estimate or p.name in times else p
            for p in flat.parameters
        ),
    )


def _is_about(error: EstimationError, times: tuple[str, ...]) -> bool:
    """Whether an error names time constants of loads alone."""
    return set(str(error.where).split(", ")) <= set(times)


def moved_apart(flat: FlatModel) -> FlatModel:
    """The model with every estimated value off by another part of itself."""
    number = count(1)
    return replace(
        flat,
        parameters=tuple(
            replace(p, value=_inside(p, p.value * (1.0 + GATES.start_apart * next(number))))
            if p.estimate
            else p
            for p in flat.parameters
        ),
    )


def _inside(parameter: Parameter, value: float) -> float:
    low = -np.inf if parameter.min is None else parameter.min
    high = np.inf if parameter.max is None else parameter.max
    return value if low < value < high else parameter.value


def _fit_from(
    loaded: FlatModel,
    times: tuple[str, ...],
    experiments: Sequence[Experiment],
    hold: Hold,
    slowest: float | None,
    is_affine: bool,
    is_simulated: bool = False,
) -> FitResult:
    """The fit from the values of the model; `is_simulated`: at which it simulates best without loads."""
    bounds = dict.fromkeys(times, _time_constants(experiments, slowest))
    physical = tuple(p.name for p in loaded.parameters if p.estimate)
    # What is missing colours the residuals: other starts would be tried in vain.
    given = IdentifyOptions(method="pem", hold=hold, second_look=False)
    try:
        options = replace(given, estimate=(*physical, *bounds), bounds=bounds)
        fit = identify(loaded, experiments, options)
        if not is_affine:
            fit = _from_faster_loads(fit, loaded, experiments, options, times)
        if is_simulated:
            return fit
        return _from_simulation(fit, loaded, experiments, options, physical)
    except EstimationError as error:
        if not _is_about(error, times):
            raise
        # Nothing in the data tells the time constants apart: the most likely of a few.
        return _with_given_time_constants(loaded, times, physical, experiments, given, slowest)


def _from_faster_loads(
    fit: FitResult,
    loaded: FlatModel,
    experiments: Sequence[Experiment],
    options: IdentifyOptions,
    times: tuple[str, ...],
) -> FitResult:
    """The more likely of the `fit` and one that starts from faster loads: in a nonlinear model several loads
    have several optima, and rounding decides in which of them a single search ends."""
    faster = {name: FASTER_LOAD * period_of(experiments) for name in times}
    with suppress(EstimationError):
        other = identify(loaded, experiments, replace(options, start=faster))
        return other if other.log_likelihood > fit.log_likelihood else fit
    return fit


def _from_simulation(
    fit: FitResult,
    loaded: FlatModel,
    experiments: Sequence[Experiment],
    options: IdentifyOptions,
    physical: tuple[str, ...],
) -> FitResult:
    """The more likely of the `fit` and one that starts where the model without loads simulates best, beyond
    hills if need be: what the given values of the parameters `physical` lack, loads do as well, and the
    search may end beside them. That of a shaft, sampled four times in a period of its resonance, did."""
    if not physical:
        return fit
    alone = replace(options, method="oe", estimate=physical, bounds={}, hills=True)
    with suppress(EstimationError):
        simulated = identify(loaded, experiments, alone)
        start = {name: simulated.theta[name] for name in physical}
        other = identify(loaded, experiments, replace(options, start=start, least=fit.log_likelihood))
        return other if other.log_likelihood > fit.log_likelihood else fit
    return fit


def _with_given_time_constants(
    loaded: FlatModel,
    times: tuple[str, ...],
    physical: tuple[str, ...],
    experiments: Sequence[Experiment],
    given: IdentifyOptions,
    slowest: float | None,
) -> FitResult:
    fits = []
    for periods in GIVEN_LOADS:
        T = min(periods * period_of(experiments), _time_constants(experiments, slowest)[1])
        fix = dict.fromkeys(times, T)
        options = replace(given, estimate=physical, fix=fix, noises_alone=not physical)
        fits.append(identify(loaded, experiments, options))
    return max(fits, key=lambda fit: fit.log_likelihood)


def _at_estimate(
    loaded: FlatModel,
    fit: FitResult,
    places: tuple[LoadPlace, ...],
    experiments: tuple[Experiment, ...],
) -> Null:
    valued = loaded.with_theta(fit.theta)
    explicit = reduce_index(valued)
    return Null(
        flat=pinned(valued, explicit),
        explicit=explicit,
        fit=fit,
        loads=loads_of(fit, places),
        places=places,
        experiments=experiments,
        hold=fit.hold,
    )


def pinned(flat: FlatModel, explicit: ExplicitModel) -> FlatModel:
    """`flat` with the states of `explicit` as its states for good: models grown from it share them. Loads
    stay kept before them."""
    states = set(explicit.state_names)
    unknowns = tuple(
        replace(v, state_select="always") if v.name in states and v.state_select != "kept" else v
        for v in flat.unknowns
    )
    return replace(flat, unknowns=unknowns)


def grown(
    null: Null, flat: FlatModel, explicit: ExplicitModel, fit: FitResult, experiments: Sequence[Experiment]
) -> Null:
    """The null for a model that grew out of it: same places of loads, values and sizes of the new fit."""
    return replace(
        null,
        flat=pinned(flat.with_theta(fit.theta), explicit),
        explicit=explicit,
        fit=fit,
        loads=loads_of(fit, null.places),
        experiments=tuple(experiments),
    )


def simulation_options(null: Null, names: Sequence[str], iterations: int) -> IdentifyOptions:
    """Of fits of the parameters `names` by simulation, in which the loads are without memory: the free
    initial state of one that decays slowly would be a law of its own, the transient of a lag."""
    return IdentifyOptions(
        method="oe",
        estimate=tuple(names),
        fix=null.shortest_times,
        hold=null.hold,
        max_iterations=iterations,
        second_look=False,
        shooting=1,
        enough=GATES.enough_simulated,
        noises_alone=not names,
    )


def at_fit(null: Null, fit: FitResult) -> Null:
    """The null at the values of another fit of its own model."""
    flat = null.flat.with_theta(fit.theta)
    return grown(null, flat, replace(null.explicit, flat=flat), fit, null.experiments)


def loads_of(fit: FitResult, places: Sequence[LoadPlace]) -> tuple[Load, ...]:
    """Size and time constant of every load in a fit."""
    intensity = {n.name: n.value for n in fit.noises if n.kind == "process"}
    result = []
    for place in places:
        T = fit.theta[place.time_constant]
        size = float(np.sqrt(intensity.get(place.noise, 0.0) * T / 2.0))
        result.append(Load(place.load, place.names[0], place.names, T, size, place.unit))
    return tuple(result)


def refit(
    flat: FlatModel,
    explicit: ExplicitModel,
    names: Sequence[str],
    null: Null,
    *,
    validation: Sequence[Experiment] = (),
    max_iterations: int = 40,
    hopeless: float = -np.inf,
) -> FitResult:
    """The fit of `refitted` with its agreements."""
    found = refitted(flat, explicit, names, null, max_iterations=max_iterations, hopeless=hopeless)
    return found.judged(validation)


def searched_names(null: Null, names: Sequence[str]) -> tuple[str, ...]:
    """The parameters that `refitted` searches in a model of which it is to tell those of `names`."""
    return (*names, *_searched_times(null))


def _searched_times(null: Null) -> tuple[str, ...]:
    return tuple(f"{load.name}.T" for load in null.loads if load.size > 0.0)


def refitted(
    flat: FlatModel,
    explicit: ExplicitModel,
    names: Sequence[str],
    null: Null,
    *,
    max_iterations: int = 40,
    hopeless: float = -np.inf,
    least: float = -np.inf,
) -> Refit:
    """Fit a model that contains the null's loads, starting from the values in `flat`, noise from the null's.
    A search whose first pass stays below the log-likelihood `hopeless` is not pursued, nor one that gains too
    little to come up to `least`.

    The time constants of the loads are fitted, too, though not told as parameters: with an effect in the
    model, what is left unexplained is slower or faster than it was.
    """
    known = {p.name: p for p in flat.parameters}
    bounds = {name: (known[name].min, known[name].max) for name in names}
    times = dict.fromkeys(_searched_times(null), _time_constants(null.experiments, null.slowest))
    coordinates = tuple(
        parameter_coordinate(flat, name, known[name].value, limits)
        for name, limits in (bounds | times).items()
    )
    n_w = len(flat.noises)
    unknowns = Unknowns(coordinates, flat.theta_values, np.zeros(n_w), np.ones(len(flat.outputs)))
    levels = dict(zip(null.flat.noise_names, null.intensity, strict=True))
    intensity = np.array([levels.get(w.name, 0.0) for w in flat.noises])
    options = IdentifyOptions(hold=null.hold, max_iterations=max_iterations)
    found = search_on(
        explicit,
        unknowns,
        null.experiments,
        np.array([w.name in levels for w in flat.noises], dtype=bool),
        options,
        WarmStart(
            intensity,
            null.starting_std,
            null.initial_states,
            at_rest=tuple(load.name for load in null.loads),
            hopeless=hopeless,
            least=least,
        ),
    )
    fit, n_told = found.fit, len(names)
    told = replace(
        fit,
        parameters=fit.parameters[:n_told],
        correlation_names=fit.correlation_names[:n_told],
        correlation=fit.correlation[:n_told, :n_told],
    )
    return replace(found, fit=told)
