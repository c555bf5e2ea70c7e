"""Candidates: every effect of the library at every place where it fits, with the shapes worth trying."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from itertools import chain, count, product

import casadi as ca
import numpy as np

from daest.diagnosis.null_model.null import Null, grown
from daest.diagnosis.screening.grown_states import brought_rows, with_integrals
from daest.errors import DaestError
from daest.model.diagnosis import Candidate, Proof
from daest.model.effects import PER_TIME, Effect, EffectParameter, Placement, Site
from daest.model.experiment import Experiment
from daest.model.flat import ExplicitModel, FlatModel, with_equations
from daest.modelica.effects.attach import attach_all, check_values
from daest.modelica.flat.clock import clock_unit
from daest.modelica.places.balances import domain_of, is_length
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import fits
from daest.numerics.evaluator import along
from daest.quantities import is_known_unit, is_of, is_temperature
from daest.systems.reduction.reduce import chosen_states, reduce_index

MOST_SHAPES = 32  # of one effect at one place: thinned out, periodic effects lose whole phases
TIME = "time"  # a grid may be relative to it: the duration of the recording
SAMPLE = "sample"  # the same: its sampling period
ANGLE = "phi"  # of the body at a place, as the effects that hold it call it
TURNS_ON = "the body turns on and on: what would hold it ends before"
MOST_PERIODS = 60  # in a turn, that the data are searched for
MOST_LENGTHS = 200  # of a period along a way, that the data are searched for
LENGTHS_APART = 4  # steps by which the number of periods over a whole way grows by one
MOST_INSIDE = 24  # signals inside of a model that are places of a search: of more, none that is not named
MOST_POINTS = 400  # of a trajectory that a range is taken from
LEARNED = "Learned"  # curves describe what no effect explains; they are no hypothesis themselves
NO_SITES = ("parameter",)  # parameters that change have a search of their own


def pairs(
    effects: Sequence[Effect],
    places: Sequence[Site],
    columns: Sequence[str] = (),
    taken: Collection[str] = (),
    driving: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
) -> tuple[Candidate, ...]:
    """Effects at sites, shapes not yet chosen, under names that no component of `taken` has. Effects that
    need a measured signal are tried with every one of `columns`, the recorded signals that the model does not
    use and whose `units` fit as far as they are known, or with every one of the inputs that are `driving` it.

    What flows to ground leaves the model: an effect between two nodes that would say
    the same as one of a single node is left out. So are signals inside, where there are too many."""
    found, units = list[Candidate](), units or {}
    if sum(site.kind == "signal" for site in places) > MOST_INSIDE:
        places = [site for site in places if site.kind != "signal"]
    known = {effect.name for effect in effects}
    stems = {"_".join(name.split("_")[:2]) for name in taken}  # a shape adds its number
    names = (name for n in count(1) if (name := f"effect_{n}") not in stems)
    for effect in effects:
        if effect.name.startswith(LEARNED):
            continue
        for site in places:
            if site.kind in NO_SITES or not fits(effect, site):
                continue
            if site.is_grounded and effect.grounded in known:
                continue
            if not effect.inputs:
                found.append(Candidate(effect, site, next(names)))
                continue
            feeding = driving if effect.is_of_driving else _fitting(effect, columns, units)
            for column in feeding:
                supply = {effect.inputs[0]: column}
                unit = {effect.inputs[0]: units[column]} if column in units else {}
                found.append(Candidate(effect, site, next(names), {}, supply, unit))
    return tuple(found)


def _fitting(effect: Effect, columns: Sequence[str], units: Mapping[str, str]) -> list[str]:
    """The columns that may supply an effect: of another unit than it wants none, for a temperature none whose
    unit is not known. No temperature is a flow of heat: its zero is another one in another unit."""
    wanted = effect.input_units[0]

    def is_fitting(unit: str) -> bool:
        if is_temperature(wanted) or (effect.domain == "thermal" and is_temperature(unit)):
            return is_temperature(wanted) and is_temperature(unit)
        return not (wanted and is_known_unit(unit)) or is_of(unit, wanted)

    return [column for column in columns if is_fitting(units.get(column, ""))]


def keeping_order(
    flat: FlatModel, explicit: ExplicitModel, candidates: Sequence[Candidate]
) -> tuple[Candidate, ...]:
    """The candidates, with a word where an effect that changes the order elsewhere keeps that of `explicit`,
    the explicit form of `flat`; those of a store only where they do, since there is one."""

    def keeps(candidate: Candidate) -> bool:
        if not candidate.effect.is_dynamic or candidate.is_of_signal:
            return False
        try:
            whole = attached(flat, [candidate])
            if chosen_states(whole) != explicit.state_names:
                return False
            grown = reduce_index(whole)
        except DaestError:
            return False
        # What an input holds is no store, though its rate is known.
        is_held = len(grown.input_derivatives) > len(explicit.input_derivatives)
        is_no_store = candidate.effect.is_of_store and (is_held or not _is_stored(grown, candidate))
        return not is_no_store

    told = (replace(c, keeps_order=True) if keeps(c) else c for c in candidates)
    return tuple(c for c in told if c.keeps_order or not c.effect.is_of_store)


def _is_stored(grown: ExplicitModel, candidate: Candidate) -> bool:
    """Whether the effect in the model `grown` acts on states of its own domain, and on no others: a voltage
    that is induced by a speed is no store of charge."""
    sizes = {f"{candidate.name}.{p.name}" for p in candidate.effect.sizes}
    columns = [k for k, p in enumerate(grown.flat.parameters) if p.name in sizes]
    acts = grown.rhs.jac_sparsity(0, 4)
    units = {u.name: u.unit for u in grown.flat.unknowns}
    moved = [
        "hydraulic" if is_length(units.get(name, "")) else domain_of(units.get(name, ""))
        for i, name in enumerate(grown.state_names)
        if any(acts.has_nz(i, k) for k in columns)
    ]
    return bool(moved) and all(domain == candidate.effect.domain for domain in moved)


def fed(experiments: Sequence[Experiment], candidate: Candidate) -> tuple[Experiment, ...]:
    """The experiments with the recorded signals that the effect needs as further inputs."""
    names = () if candidate.effect.is_of_variable else tuple(candidate.inputs.values())
    return tuple(e.driven_by(names) for e in experiments) if names else tuple(experiments)


def with_law(null: Null, proof: Proof) -> Null:
    """The null for the model with the law of a `proof`, at its refit beside the loads. Raises FmuError
    `fmu-no-equations`."""
    flat = with_equations(proof.flat, "a further round")
    return grown(null, flat, reduce_index(flat), proof.fit, fed(null.experiments, proof.candidate))


def with_shapes(
    flat: FlatModel,
    candidates: Sequence[Candidate],
    time: np.ndarray,
    states: Mapping[str, np.ndarray],
    inputs: np.ndarray,
    innovations: np.ndarray | None = None,
) -> tuple[tuple[Candidate, ...], tuple[tuple[str, str], ...]]:
    """One candidate per shape, with sharpness and shapes in multiples of what the variables reach along the
    trajectory `states` (by name, each (n_samples,)); and those that cannot be attached, with the reason."""
    usable, refused, explicit = attachable(flat, candidates)
    shaped = in_shapes(flat, usable, explicit, time, states, inputs, innovations)
    return tuple(chain.from_iterable(shaped)), (*refused, *without_shape(usable, shaped))


def without_shape(
    usable: Sequence[Candidate], shaped: Sequence[Sequence[Candidate]]
) -> tuple[tuple[str, str], ...]:
    """Those of the `usable` candidates that have no shape by `in_shapes`, with the reason."""
    return tuple((c.label, TURNS_ON) for c, several in zip(usable, shaped, strict=True) if not several)


def in_shapes(
    flat: FlatModel,
    usable: Sequence[Candidate],
    explicit: ExplicitModel,
    time: np.ndarray,
    states: Mapping[str, np.ndarray],
    inputs: np.ndarray,
    innovations: np.ndarray | None = None,
) -> list[list[Candidate]]:
    """The shapes of every candidate, as `with_shapes` has them; `explicit` is the model with all of them.
    None of one that holds a body which turns on and on."""
    reached = ranges(explicit, time, states, inputs)
    counts = {} if innovations is None else periods(usable, explicit, time, states, inputs, innovations)
    clock = clock_unit(flat)
    result: list[list[Candidate]] = []
    for candidate in usable:
        if _turns_on(candidate, reached):
            result.append([])
            continue
        units, shaped = units_at(flat, candidate.effect, candidate.site, clock, candidate.inputs), []
        proved = _proved(candidate, reached)
        for number, values in enumerate(_shapes(candidate, reached, counts)):
            name = f"{candidate.name}_{number + 1}"
            searched = _n_searched(candidate, values, counts)
            shaped.append(
                replace(
                    candidate,
                    effect=_with_fitted_number(candidate.effect, values),
                    name=name,
                    shape=values,
                    units=units,
                    searched=searched,
                    proved=proved,
                )
            )
        result.append(shaped)
    return result


def _with_fitted_number(effect: Effect, values: Mapping[str, float]) -> Effect:
    """The effect, whose number of periods in a turn is fitted where the data show no whole one."""

    def is_shown(p: EffectParameter) -> bool:
        return bool(p.periods_over) and not values.get(p.name, p.start).is_integer()

    if not any(is_shown(p) and not p.estimate for p in effect.parameters):
        return effect
    parameters = tuple(replace(p, estimate=p.estimate or is_shown(p)) for p in effect.parameters)
    return replace(effect, parameters=parameters)


def _turns_on(candidate: Candidate, reached: Mapping[str, float]) -> bool:
    """Whether the body at the place turns further than the effect can hold one."""
    most = candidate.effect.most_turns
    return most is not None and reached.get(f"{candidate.name}.{ANGLE}", 0.0) > 2.0 * np.pi * most


def attachable(
    flat: FlatModel, candidates: Sequence[Candidate]
) -> tuple[tuple[Candidate, ...], tuple[tuple[str, str], ...], ExplicitModel]:
    """The candidates that leave a model that can be solved, the others with the reason, and that model."""
    possible, refused = with_possible_values(candidates)
    # What changes a store gives way to what has a state of its own, which is the more usual.
    ordered = sorted(possible, key=lambda c: c.effect.is_of_store)
    found, others, whole = _told_apart(flat, tuple(ordered), ())
    names = {c.name for c in found}
    kept = tuple(c for c in possible if c.name in names)
    if whole is None:
        try:
            whole = explicit_at_null(flat, kept)
        except DaestError:
            # An orifice may be solved behind others and not before them: the order that was tried.
            kept, whole = found, explicit_at_null(flat, found)
    return kept, (*refused, *others), whole


def in_models(
    flat: FlatModel, candidates: Sequence[Candidate]
) -> tuple[tuple[tuple[Candidate, ...], ExplicitModel], ...]:
    """The candidates in as few models as can hold them: some cannot be attached beside others. Those that
    cannot at all are left out."""
    kept, _, explicit = attachable(flat, candidates)
    left = [c for c in candidates if c not in kept]
    others = in_models(flat, left) if kept and left else ()
    return ((kept, explicit), *others) if kept else ()


def with_possible_values(
    candidates: Sequence[Candidate],
) -> tuple[tuple[Candidate, ...], tuple[tuple[str, str], ...]]:
    """The candidates whose values their effects take, which shows before any model is built."""
    kept, refused = [], []
    for candidate in candidates:
        try:
            check_values(candidate.effect, placement(candidate).values)
        except DaestError as error:
            refused.append((candidate.label, error.what))
        else:
            kept.append(candidate)
    return tuple(kept), tuple(refused)


def _told_apart(
    flat: FlatModel, candidates: tuple[Candidate, ...], beside: tuple[Candidate, ...]
) -> tuple[tuple[Candidate, ...], tuple[tuple[str, str], ...], ExplicitModel | None]:
    """As `attachable`, by halves: where one of hundreds cannot be attached `beside` those that can, few
    models are built. The model where all can be."""
    try:
        return candidates, (), explicit_at_null(flat, (*beside, *candidates))
    except DaestError as error:
        if len(candidates) == 1:
            return (), ((candidates[0].label, error.what),), None
    middle = len(candidates) // 2
    first, refused, _ = _told_apart(flat, candidates[:middle], beside)
    second, others, _ = _told_apart(flat, candidates[middle:], (*beside, *first))
    return first + second, refused + others, None


def explicit_at_null(flat: FlatModel, candidates: Sequence[Candidate]) -> ExplicitModel:
    """The explicit form of `attached`, of which values and derivatives over the sizes are wanted where all
    effects vanish. Raises what attaching and index reduction raise.

    That of a model that differs from one of the last in values alone, with the same effects in other shapes,
    is not made again: the screen in open loop asks for what the first screen has made."""
    for other, known, explicit in tuple(_attached):
        if _differ_in_values(flat, other) and _have_same_equations(candidates, known):
            return replace(explicit, flat=explicit.flat.with_theta(_values(flat, candidates)))
    sizes = {f"{c.name}.{p.name}" for c in candidates for p in c.effect.sizes}
    explicit = reduce_index(attached(flat, candidates), first_order=sizes)
    _attached.appendleft((flat, tuple(candidates), explicit))
    return explicit


_attached: deque[tuple[FlatModel, tuple[Candidate, ...], ExplicitModel]] = deque(maxlen=12)
"""What `explicit_at_null` made last, and of what."""


def _values(flat: FlatModel, candidates: Sequence[Candidate]) -> dict[str, float]:
    """Of the parameters of `flat` and of the candidates, as `attached` has them."""
    values = {p.name: p.value for p in flat.parameters}
    own = {f"{c.name}.{name}": value for c in candidates for name, value in placement(c).values.items()}
    return values | own


def _differ_in_values(one: FlatModel, other: FlatModel) -> bool:
    """Whether two models are one but for the values of their parameters."""
    rest = [f.name for f in fields(FlatModel) if f.name != "parameters"]
    return (
        len(one.parameters) == len(other.parameters)
        and all(getattr(one, name) is getattr(other, name) for name in rest)
        and all(a == replace(b, value=a.value) for a, b in zip(one.parameters, other.parameters, strict=True))
    )


def _have_same_equations(some: Sequence[Candidate], others: Sequence[Candidate]) -> bool:
    """Whether candidates bring the same equations: they differ in the values of their shapes at most."""
    return len(some) == len(others) and all(
        one.shape.keys() == other.shape.keys()
        and replace(one, shape={}, searched=1) == replace(other, shape={}, searched=1)
        for one, other in zip(some, others, strict=True)
    )


def attached(flat: FlatModel, candidates: Sequence[Candidate]) -> FlatModel:
    """`flat` with all candidates at size zero."""
    return attach_all(flat, [placement(c) for c in candidates], allow_repeated=True)


def brings_time(before: FlatModel, after: FlatModel) -> bool:
    """Whether what was attached brings the time into a model that is the same at all times."""
    return ca.depends_on(after.residual, after.time) and not ca.depends_on(before.residual, before.time)


def placement(candidate: Candidate, sizes: Mapping[str, float] | None = None) -> Placement:
    """The candidate with the given sizes, by default the ones at which it vanishes."""
    effect = candidate.effect
    values = {**effect.null_values, **candidate.shape, **(sizes or {})}
    return Placement(effect, candidate.site, candidate.name, values, candidate.inputs, candidate.input_units)


def ranges(
    explicit: ExplicitModel, time: np.ndarray, states: Mapping[str, np.ndarray], inputs: np.ndarray
) -> dict[str, float]:
    """Largest magnitude of every internal variable along the trajectory, and its duration [s] as that of
    `time`, its sampling period [s] as that of `sample`. Shapes: time (n_samples,), states (n_samples,) by
    name, inputs (n_samples, n_u)."""
    chosen = np.unique(np.linspace(0, time.size - 1, min(time.size, MOST_POINTS)).astype(int))
    along = courses(explicit, time, states, inputs, chosen)
    reached = {name: float(np.max(np.abs(row), initial=0.0)) for name, row in along.items()}
    return reached | {TIME: float(np.ptp(time)), SAMPLE: float(np.median(np.diff(time)))}


def periods(
    candidates: Sequence[Candidate],
    explicit: ExplicitModel,
    time: np.ndarray,
    states: Mapping[str, np.ndarray],
    inputs: np.ndarray,
    innovations: np.ndarray,
) -> dict[str, float]:
    """By name of the parameter, the number of periods in a turn, or the length of one along a way, whose sine
    and cosine over the effect's variable explain most of the `innovations` (n_samples, n_y)."""
    wanted = {
        f"{c.name}.{p.name}": (f"{c.name}.{p.periods_over}", bool(p.scale_of))
        for c in candidates
        for p in c.effect.parameters
        if p.periods_over
    }
    if not wanted:
        return {}
    along = courses(explicit, time, states, inputs, np.arange(time.size))
    found = {
        name: (most_likely_length if is_length else most_likely_periods)(along[variable], innovations)
        for name, (variable, is_length) in wanted.items()
        if variable in along
    }
    return {name: float(n) for name, n in found.items() if n is not None}


def most_likely_periods(angle: np.ndarray, innovations: np.ndarray) -> float | None:
    """The number of periods over 2*pi of `angle` (n_samples,) whose sine and cosine explain most of the
    `innovations` (n_samples, n_y), from two on: one in a turn is a weight off the axis, a law of its own.
    None where nothing moves, or a period is passed within two samples: what is faster would look like fewer
    periods.

    Whole numbers are told apart by a whole turn alone. Within a part of one, as that of a mount or of a joint
    behind a gear with many teeth, it is any number from two periods over the whole way on."""
    if np.ptp(angle) < 2.0 * np.pi:
        length = most_likely_length(angle, innovations)
        return None if length is None else 2.0 * np.pi / length
    fastest = np.quantile(np.abs(np.diff(angle)), 0.95)
    most = int(min(MOST_PERIODS, np.pi / fastest)) if fastest > 0.0 else MOST_PERIODS
    power = [_power(n * angle, innovations) for n in range(2, most + 1)]
    return 2.0 + int(np.argmax(power)) if power else None


def most_likely_length(way: np.ndarray, innovations: np.ndarray) -> float | None:
    """The length of a period along `way` (n_samples,) whose sine and cosine explain most of the `innovations`
    (n_samples, n_y), from two on over the whole way. None where nothing moves, or a period is passed within
    two samples."""
    whole, fastest = float(np.ptp(way)), float(np.quantile(np.abs(np.diff(way)), 0.95))
    if whole <= 0.0 or fastest <= 0.0:
        return None
    most = min(2.0 + MOST_LENGTHS / LENGTHS_APART, 0.5 * whole / fastest)
    counts = np.arange(2.0, most, 1.0 / LENGTHS_APART)
    power = [_power(2.0 * np.pi * n / whole * way, innovations) for n in counts]
    return whole / float(counts[int(np.argmax(power))]) if power else None


def _power(angle: np.ndarray, innovations: np.ndarray) -> float:
    """What sine and cosine of an angle (n_samples,) explain of the innovations (n_samples, n_y)."""
    table = np.column_stack([np.sin(angle), np.cos(angle)])
    seen = table.T @ innovations
    return float(np.sum(seen * np.linalg.lstsq(table.T @ table, seen, rcond=None)[0]))


def courses(
    explicit: ExplicitModel,
    time: np.ndarray,
    states: Mapping[str, np.ndarray],
    inputs: np.ndarray,
    chosen: np.ndarray,
) -> dict[str, np.ndarray]:
    """Every internal variable and input by name at the `chosen` samples, each (n_chosen,)."""
    x = np.array(
        [states[name][chosen] if name in states else np.zeros(chosen.size) for name in explicit.state_names]
    )
    u = np.zeros((explicit.rhs.numel_in(1), chosen.size))
    u[: inputs.shape[1]] = inputs[chosen].T
    v, w = np.zeros((explicit.rhs.numel_in(2), chosen.size)), np.zeros(explicit.rhs.numel_in(3))
    states_there = with_integrals(explicit, brought_rows(explicit, states), time[chosen], x.T, (u, v))
    columns = [states_there, u.T, v.T, w, explicit.flat.theta_values, time[chosen][:, None]]
    values = along(_dense(explicit.variables), columns)[0]
    names = explicit.flat.unknown_names
    found = dict(zip(names, values.T, strict=True))
    return found | {v.name: row for v, row in zip(explicit.flat.inputs, u, strict=True)}


def _dense(function: ca.Function) -> ca.Function:
    """The function with all elements of its result."""
    if function.sparsity_out(0).is_dense():
        return function
    arguments = [ca.MX.sym(f"a{i}", function.size_in(i)) for i in range(function.n_in())]
    return ca.Function("dense", arguments, [ca.densify(function(*arguments))])


def _shapes(
    candidate: Candidate, ranges: Mapping[str, float], counts: Mapping[str, float]
) -> list[dict[str, float]]:
    """Values of shape and sharpness parameters to try, beside those that the candidate has."""
    axes = []
    for parameter in candidate.effect.parameters:
        if parameter.role not in ("shape", "sharpness") or not parameter.grid:
            continue
        values = parameter.grid if parameter.role == "shape" else parameter.grid[:1]
        scale = _scale(candidate, parameter, ranges)
        least = -np.inf if parameter.min is None else parameter.min
        multiples = [scale * value for value in values if scale > 0.0]
        # Those of a period of time begin where samples tell it.
        seen = [value for value in multiples if not parameter.is_period_of_time or value >= least]
        tried = seen or [max(parameter.start, least)]
        shown = counts.get(f"{candidate.name}.{parameter.name}")
        if shown is not None and shown not in tried:
            tried.append(shown)
        axes.append([(parameter.name, value) for value in tried])
    combinations = [candidate.shape | dict(choice) for choice in product(*axes)]
    step = -(-len(combinations) // MOST_SHAPES)
    return combinations[::step]


def _proved(candidate: Candidate, ranges: Mapping[str, float]) -> dict[str, float]:
    """Values that a proof takes in place of those that the screen tries."""
    own = [(p, p.proof, _scale(candidate, p, ranges)) for p in candidate.effect.parameters]
    return {p.name: scale * proof for p, proof, scale in own if proof is not None and scale > 0.0}


def _n_searched(candidate: Candidate, values: Mapping[str, float], counts: Mapping[str, float]) -> int:
    """Of how many values of the shape the data chose this one; 1 where the grid has it."""
    for p in candidate.effect.parameters:
        value = values.get(p.name)
        counted = counts.get(f"{candidate.name}.{p.name}") if p.periods_over else None
        if counted is not None and value not in p.grid and value == counted:
            return MOST_LENGTHS if p.scale_of or not counted.is_integer() else MOST_PERIODS
    return 1


def _scale(candidate: Candidate, parameter: EffectParameter, ranges: Mapping[str, float]) -> float:
    """The largest magnitude of the effect's variable that the grid is relative to; 1 where it is absolute."""
    if not parameter.scale_of:
        return 1.0
    size = ranges.get(scaled_by(candidate, parameter), ranges.get(candidate.site.name, 0.0))
    return size / ranges[TIME] if parameter.is_scaled_by_rate else size


def scaled_by(candidate: Candidate, parameter: EffectParameter) -> str:
    """The name in `ranges` of what the grid of the parameter is relative to."""
    variable = parameter.scale_of.removesuffix(PER_TIME)
    return variable if variable in (TIME, SAMPLE) else f"{candidate.name}.{variable}"


def scaled_shapes(candidate: Candidate) -> list[EffectParameter]:
    """The shapes of the effect that are estimated and lie along one of its variables."""
    shapes = [p for p in candidate.effect.parameters if p.role == "shape" and p.estimate and p.scale_of]
    return [p for p in shapes if not p.is_scaled_by_rate]
