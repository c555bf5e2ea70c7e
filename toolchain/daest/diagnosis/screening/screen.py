"""Screen: the score of every candidate effect on the whitened innovations of the null, in one pass.

All candidates are attached to the null model at once with size zero. The derivative of the model with respect
to a size, evaluated on filtered variables, drives the error dynamics of the null's observer: that is the
response of the innovations to the effect. What refitted parameters and initial states would do is projected
out. Scores are jointly normal with known correlation when nothing is missing, which prices the search
exactly.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, pairwise

import casadi as ca
import numpy as np
from scipy.special import ndtri_exp

from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.error_dynamics import MOST_STATES, WatchedErrors, dynamics_along
from daest.diagnosis.null_model.null import Null, grows_beyond
from daest.diagnosis.screening.absorbed import rescaling_sizes
from daest.diagnosis.screening.candidates import (
    attachable,
    explicit_at_null,
    in_shapes,
    with_possible_values,
    without_shape,
)
from daest.diagnosis.screening.clipping import CLIPPED
from daest.diagnosis.screening.grown_states import GrownStates, Inputs, grown_states
from daest.diagnosis.screening.size_slopes import Sizes, sizes_of, slopes_over
from daest.errors import EstimationError
from daest.estimation.fitting.records import RUN_LENGTHS, part_of
from daest.estimation.nonlinear.observer import AverageModel, average_model, observer
from daest.model.diagnosis import Candidate, Screen, Screened
from daest.model.experiment import Experiment
from daest.model.flat import ExplicitModel
from daest.modelica.effects.attach import components_with
from daest.numerics.evaluator import along
from daest.numerics.parallel import Workers, called
from daest.numerics.statistics import autoregression, chi2, norm
from daest.numerics.tables import turned
from daest.systems.events.integration import Correction, IntegrationError, Trajectory
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.simulation.integrate import (
    Integrator,
    inputs_at_ends,
    integrate,
    integrator,
    interval_inputs,
)
from daest.systems.simulation.sensor_laws import slopes_along
from daest.systems.tolerances import SOLVER

TAIL = 100  # draws, the highest, beyond which the normal law extends the share above a score
DRAWS = 20_000  # of the largest score under the null
RTOL = 1e-4  # of a run of an observer: that of the refits, ...
ATOL_OF_SCALE = 0.1  # ... with their absolute tolerance where the sizes of the states are known
ALONE = "has states that do not follow the model alone"  # why an effect is skipped
NO_SOLUTION = "its equations have no solution along the recordings"
LOUDER = tuple(10.0**power for power in range(0, 40, 2))  # loads, until an observer exists
LEAST_INTENSITY = 1e-30  # of a load that is none, from which that search begins
HALVINGS = 8  # of a gain with which the observer runs away
AT_HAND = 1 << 20  # numbers (8 MiB) of the responses that are made at a time
MOST_SENT = 1 << 24  # numbers (128 MiB) of the responses that another process makes


@dataclass(frozen=True)
class Observed:
    """The null's observer run over one experiment: predicted and filtered states (n_samples, n) by
    `state_names`, whitened innovations (n_samples, n_y) and their slopes (k, n_samples, n_y) over parameters
    and initial states; relative slopes of the sensors (n_samples, n_y) that the gain follows."""

    predicted: np.ndarray
    filtered: np.ndarray
    whitened: np.ndarray
    slopes: np.ndarray
    sensors: np.ndarray


@dataclass(frozen=True)
class NullObserver:
    """The observer of `null`, with what the innovations of all experiments are made of."""

    null: Null
    state_names: tuple[str, ...]
    average: AverageModel
    gain: np.ndarray  # (n, n_y), zero where no gain exists or nothing drives the states
    is_optimal: bool  # the gain is the stationary one of the average, which may be too much along the motion
    root: np.ndarray  # inverse root of the innovation covariance (n_y, n_y)
    observed: tuple[Observed, ...]

    @cached_property
    def dynamics(self) -> tuple[WatchedErrors, ...]:
        """Of every experiment. Asked for by responses alone: most candidates are judged without any."""
        null = self.null
        filtered, predicted = [o.filtered for o in self.observed], [o.predicted for o in self.observed]
        every = dynamics_along(
            null.explicit, self.average, null.experiments, filtered, predicted, null.hold, RTOL
        )
        return tuple(
            one.watched(self.gain, _correcting(null, experiment, observed))
            for one, experiment, observed in zip(every, null.experiments, self.observed, strict=True)
        )

    @cached_property
    def sizes(self) -> np.ndarray:
        """Largest magnitude (n,) of every state along the experiments. Of one that rests at zero nothing is
        known: its size is such that its absolute tolerance is that without a size."""
        size = np.max([np.max(np.abs(o.predicted), axis=0) for o in self.observed], axis=0)
        return np.where(np.isfinite(size) & (size > 0.0), size, SOLVER.atol_of_scale / ATOL_OF_SCALE)

    @property
    def whitened(self) -> np.ndarray:
        """Whitened errors (m,) of all experiments, one after the other."""
        return np.concatenate([o.whitened.ravel() for o in self.observed])


def run_null(null: Null) -> NullObserver:
    """Run the observer of the null over its experiments."""
    model = integrator(null.explicit, null.estimated)
    names = null.explicit.state_names
    starts = [np.array([state.get(name, 0.0) for name in names]) for state in null.initial_states]
    longest = int(np.argmax([e.n_samples for e in null.experiments]))
    experiment = null.experiments[longest]
    piece, free = _simulated(null, model, experiment, starts[longest])
    average = _average(null, piece, free)
    whole = _whole_gain(null, average)
    gain, runs, errors = _followed(null, model, starts, whole)
    is_whole = piece is experiment
    if not is_whole or _has_run_away(null, experiment.outputs - free.outputs, GATES.free_runaway):
        # What falls over in a simulation is held by an observer, and bends otherwise there.
        is_held = bool(np.any(gain)) and not _has_run_away(null, np.concatenate(errors), GATES.free_runaway)
        if is_whole and not is_held:
            _, runs, _ = _followed(null, model, starts, _gain_before_falling(null, model, experiment, free))
        average = _average(null, experiment, runs[longest])
        whole = _whole_gain(null, average)
        gain, runs, errors = _followed(null, model, starts, whole)
    root = np.linalg.inv(np.linalg.cholesky(error_covariance(np.concatenate(errors))))
    observed = tuple(
        _observed(null, *one, gain, root) for one in zip(null.experiments, runs, errors, strict=True)
    )
    return NullObserver(null, names, average, gain, gain is whole and bool(np.any(gain)), root, observed)


def _correcting(null: Null, experiment: Experiment, observed: Observed) -> np.ndarray:
    """The relative slopes (n_samples, n_y) of the sensors by which the observer corrects: none where a sample
    is missing. Of more states than are followed along a recording, all are taken for measured."""
    if null.explicit.n_states > MOST_STATES:
        return observed.sensors
    return np.where(np.isfinite(experiment.outputs), observed.sensors, 0.0)


def error_covariance(errors: np.ndarray) -> np.ndarray:
    """The covariance (n_y, n_y) of errors (n_samples, n_y), NaN where a sample is missing: of the instants at
    which all outputs were measured, or of each output alone where these are too few, as of sensors that are
    read at different times."""
    together = measured_together(errors)
    if together.size:
        return together.T @ together / together.shape[0]
    known = np.isfinite(errors)
    squares = np.where(known, errors, 0.0) ** 2
    return np.diag(squares.sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def measured_together(errors: np.ndarray) -> np.ndarray:
    """Those errors (m, n_y) of (n_samples, n_y) without a missing sample; none, where these are too few to
    tell how the outputs err together."""
    complete = errors[np.all(np.isfinite(errors), axis=1)]
    return complete if complete.shape[0] >= GATES.min_complete * errors.shape[1] else complete[:0]


def _simulated(
    null: Null, model: Integrator, experiment: Experiment, start: np.ndarray
) -> tuple[Experiment, Trajectory]:
    """The experiment, or as much of its beginning as a simulation gets through, and this simulation."""
    pieces = (part_of(experiment, 0, length) for length in RUN_LENGTHS if length < experiment.n_samples)
    for piece in (experiment, *pieces):
        try:
            return piece, integrate(
                model, piece.time, piece.inputs, null.theta, start, hold=null.hold, rtol=RTOL
            )
        except IntegrationError as error:
            failure = error
    raise failure


def _gain_before_falling(
    null: Null, model: Integrator, experiment: Experiment, free: Trajectory
) -> np.ndarray:
    """The stationary gain (n, n_y) of the model as it is along the simulation `free` until that runs away
    from the experiment: where a pendulum hangs after its fall it needs no observer."""
    spread = np.nanstd(experiment.outputs, axis=0)
    away = np.abs(experiment.outputs - free.outputs) > GATES.free_runaway * spread
    n_samples = max(int(np.argmax(np.any(away, axis=1))), 2)
    piece, run = _simulated(null, model, part_of(experiment, 0, n_samples), free.states[0])
    return _whole_gain(null, _average(null, piece, run))


def _observed(
    null: Null, experiment: Experiment, run: Trajectory, error: np.ndarray, gain: np.ndarray, root: np.ndarray
) -> Observed:
    known = np.isfinite(error)
    sensors = slopes_along(null.explicit, null.theta, experiment.time, run.states, _ubar(null, experiment))
    return Observed(
        predicted=run.states,
        filtered=run.states + np.where(known, sensors * error, 0.0) @ gain.T,
        whitened=np.where(known, error, 0.0) @ turned(root),
        slopes=np.where(known, run.sensitivities.transpose(2, 0, 1), 0.0) @ turned(root),
        sensors=sensors,
    )


def _followed(
    null: Null, model: Integrator, starts: Sequence[np.ndarray], gain: np.ndarray
) -> tuple[np.ndarray, list[Trajectory], list[np.ndarray]]:
    """The largest gain, halved as often as it takes or zero, that does not run away from the measurements,
    with its trajectories and errors. A law that sticks damps on average far more than in motion, and the gain
    for so much damping may be unstable there."""
    for share in (*(0.5**i for i in range(HALVINGS)), 0.0):
        tried = gain if share == 1.0 else share * gain
        try:
            runs = [_run(null, model, e, x0, tried) for e, x0 in zip(null.experiments, starts, strict=True)]
        except IntegrationError:
            if not share:
                raise
            continue
        errors = [e.outputs - r.outputs for e, r in zip(null.experiments, runs, strict=True)]
        if not share or not _has_run_away(null, np.concatenate(errors)):
            break
    return tried, runs, errors


def _has_run_away(null: Null, errors: np.ndarray, most: float = GATES.observer_runaway) -> bool:
    """Whether errors (n_samples, n_y) of any output are more than so many of its standard deviations."""
    spread = np.nanstd(np.concatenate([e.outputs for e in null.experiments]), axis=0)
    largest = np.abs(np.where(np.isnan(errors), 0.0, errors)).max(axis=0)
    return not np.all(largest < most * spread)


def _average(null: Null, experiment: Experiment, run: Trajectory) -> AverageModel:
    ubar = _ubar(null, experiment)
    return average_model(null.explicit, null.theta, experiment.time, run.states, ubar)


def _whole_gain(null: Null, average: AverageModel) -> np.ndarray:
    """The stationary gain of an average (n, n_y); zero where there is none."""
    found = observer(average, null.intensity, null.measurement_std)
    if found is None and grows_beyond(average.A, null.experiments):
        # What falls over needs an observer, and has none beside loads that are lost in rounding.
        least = np.maximum(null.intensity, LEAST_INTENSITY)
        tried = (observer(average, least * factor, null.measurement_std) for factor in LOUDER)
        found = next((one for one in tried if one is not None), None)
    n_y, n = average.C.shape
    return np.zeros((n, n_y)) if found is None else found.gain


def _ubar(null: Null, experiment: Experiment) -> np.ndarray:
    u0, _ = interval_inputs(null.explicit, experiment.time, experiment.inputs, null.hold)
    return np.vstack([u0, u0[-1:]])


def _run(
    null: Null, model: Integrator, experiment: Experiment, x0: np.ndarray, gain: np.ndarray
) -> Trajectory:
    return integrate(
        model,
        experiment.time,
        experiment.inputs,
        null.theta,
        x0,
        hold=null.hold,
        sensitivities=True,
        correction=Correction(experiment.outputs, gain),
        rtol=RTOL,
    )


def screen(
    null: Null,
    run: NullObserver,
    candidates: Sequence[Candidate],
    seed: int = 0,
    pool: Workers | None = None,
) -> Screen:
    """Scores of all candidates at their best shapes, best first. Candidates that change the order of the
    model, or that cannot be attached, are listed as skipped with the reason. The `pool` may take a part.

    Raises EstimationError `diagnose-no-candidate`.
    """
    present = already_there(null, candidates)
    regular = [c for c, there in zip(candidates, present, strict=True) if not there and not c.is_dynamic]
    fitted = "fitted by simulation, not screened"
    if not has_affine_dynamics(null.explicit):
        fitted = "fitted by simulation where nothing else is accepted"
    skipped = [
        (c.label, there or f"changes the order of the model: {fitted}")
        for c, there in zip(candidates, present, strict=True)
        if c not in regular
    ]
    contained = {c.label for c, there in zip(candidates, present, strict=True) if there}
    with_states = [c for c in regular if c.effect.n_states and not c.keeps_order]
    following = _following(null, run, with_states)

    def without(left: Sequence[Candidate]) -> Screen:
        others = [(c.label, ALONE) for c in left]
        wanted = [c for c in regular if c not in left]
        among = (seed, len(candidates), pool or Workers())
        found = _screened(null, run, wanted, [*skipped, *others], *among)
        return _without_sums(found, contained)

    if following:
        with suppress(EstimationError):
            return without([c for c in with_states if c not in following])
    return without(with_states)


def _without_sums(found: Screen, contained: set[str]) -> Screen:
    """The screen without effects that are another one here: sums of effects, all but one of which the model
    contains or its parameters do, or which the recordings do not tell from the first of them. Friction in
    one direction is dry friction beside a constant load that is estimated, and on a wheel that turns in this
    direction alone, as damping in one direction is viscous friction. At a place that the sensors do not tell
    from such a one it is the same."""
    done = contained | {entry.candidate.label for entry in found.entries if entry.absorbed}
    at = {entry.candidate.label: i for i, entry in enumerate(found.entries)}
    alike = np.abs(found.correlation) > GATES.same_place_correlation
    others: dict[str, str] = {}
    for i, entry in enumerate(found.entries):
        effect, place = entry.candidate.effect, entry.candidate.site.name
        parts = [f"{name} at {place}" for name in effect.sum_of]
        left = [part for part in parts if part not in done]
        plain = f"{effect.one_way} at {place}"
        if parts and len(left) == 1 and left[0] in at:
            reason = f"the model as it is makes it the same as {left[0]}"
            others |= {
                other.candidate.label: reason
                for other, is_alike in zip(found.entries, alike[i], strict=True)
                if is_alike and other.candidate.effect is effect
            }
        elif parts and parts[0] in left and parts[0] in at and alike[i, at[parts[0]]]:
            others[entry.candidate.label] = f"these recordings do not tell it from {parts[0]}"
        elif plain in at and alike[i, at[plain]]:
            others[entry.candidate.label] = f"these recordings do not tell it from {plain}"
    keep = [i for i, entry in enumerate(found.entries) if entry.candidate.label not in others]
    return replace(found.only(keep), skipped=(*found.skipped, *others.items()))


def _following(null: Null, run: NullObserver, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those of the candidates with states whose states follow those of the model: all, or all of an effect
    where those of another one do not."""
    if not candidates or _follow_the_model(null, run, candidates):
        return list(candidates)
    names = dict.fromkeys(c.effect.class_name for c in candidates)
    if len(names) == 1:
        return []
    kinds = [[c for c in candidates if c.effect.class_name == name] for name in names]
    return [c for kind in kinds if _follow_the_model(null, run, kind) for c in kind]


def _grown(null: Null, run: NullObserver, explicit: ExplicitModel) -> GrownStates:
    """How the states of a model with effects follow from those of the model, in the middle of a recording."""
    states, inputs = run.observed[0].filtered.mean(axis=0), null.experiments[0].inputs.mean(axis=0)
    return grown_states(null.explicit, null.theta, states, inputs, explicit)


def _follow_the_model(null: Null, run: NullObserver, candidates: Sequence[Candidate]) -> bool:
    """Whether the states of effects follow those of the model, as far as these effects alone tell: they are
    few, and what all candidates together would tell takes as long as the screen."""
    explicit = attachable(null.flat, candidates)[2]
    try:
        _grown(null, run, explicit)
    except EstimationError:
        return False
    return True


def _screened(
    null: Null,
    run: NullObserver,
    static: Sequence[Candidate],
    skipped: Sequence[tuple[str, str]],
    seed: int,
    n_all: int,
    pool: Workers,
) -> Screen:
    # States that effects bring beside those that the model has already leave others no place for theirs.
    groups = [[c for c in static if c.keeps_order is kept] for kept in (False, True)]
    parts = [part for group in groups if group for part in _in_models(null, run, group, pool)]
    usable = tuple(chain.from_iterable(part.candidates for part in parts))
    refused = tuple(chain.from_iterable(part.refused for part in parts))
    if not usable and len(static) == n_all:
        raise EstimationError(
            "diagnose-no-candidate",
            "no effect of the library fits any place of this model",
            remedy="name effects and places (--effect, --at), or see `daest effects`",
        )
    if not usable:
        return Screen((), np.zeros((0, 0)), 1.0, 0, (*skipped, *refused))
    responses = np.concatenate([part.responses for part in parts if part.candidates])
    ends = np.cumsum([0, *(len(c.effect.sizes) for c in usable)]).tolist()
    columns = [slice(begin, end) for begin, end in pairwise(ends)]
    directions = nuisance(run, len(null.estimated))
    rescaling = np.vstack([directions, loads_rescaled(null, run)])
    return scored(
        usable,
        columns,
        run.whitened,
        directions,
        rescaling,
        responses,
        (*skipped, *refused),
        seed,
    )


@dataclass(frozen=True)
class _Responding:
    """Candidates at their shapes, the `responses` (k, m) of the whitened innovations to their sizes, and what
    cannot be attached with the reason; `left` are those that cannot be beside the others."""

    candidates: tuple[Candidate, ...]
    responses: np.ndarray
    refused: tuple[tuple[str, str], ...]
    left: tuple[Candidate, ...] = ()


def _in_models(
    null: Null, run: NullObserver, static: Sequence[Candidate], pool: Workers
) -> list[_Responding]:
    """What candidates do to the innovations. Those that cannot be attached beside the others, such as a
    capacity at a node where every branch has got an inductance, are in further models."""
    part = _responding(null, run, static, pool)
    if not part.left or len(part.left) == len(static):
        return [part]
    names = {c.label for c in part.left}
    others = tuple(pair for pair in part.refused if pair[0] not in names)
    return [replace(part, refused=others), *_in_models(null, run, part.left, pool)]


def _responding(null: Null, run: NullObserver, static: Sequence[Candidate], pool: Workers) -> _Responding:
    """The candidates with a shape for each that is worth trying, and what each does to the innovations.

    All shapes of an effect without states are values of its parameters in one model. One with states has a
    component for every shape: along the motion its states differ. These are one task, which takes about as
    long as what came before it."""
    began = time.monotonic()
    first, filtered = null.experiments[0], run.observed[0].filtered
    states = dict(zip(run.state_names, filtered.T, strict=True))
    usable, refused, explicit = attachable(null.flat, static)
    left = tuple(c for c in static if c not in usable)
    along_first = (explicit, first.time, states, first.inputs, run.observed[0].whitened)
    shaped = in_shapes(null.flat, usable, *along_first)
    pairs = [(c, one) for c, several in zip(usable, shaped, strict=True) for one in several]
    own = [one for c, one in pairs if c.effect.n_states]
    beside = [partial(_in_own_components, null, run, own)]
    seconds = time.monotonic() - began if own and _may_be_sent(run, own) else 0.0
    pool.begin(called, beside, seconds=seconds)
    in_one = _in_one_model(null, run, explicit, [pair for pair in pairs if not pair[0].effect.n_states])
    in_own = next(pool.map(called, beside, seconds=seconds)).get()
    refused = (*refused, *without_shape(usable, shaped))
    return replace(_in_order([one.name for _, one in pairs], (in_one, in_own), refused), left=left)


def _may_be_sent(run: NullObserver, shaped: Sequence[Candidate]) -> bool:
    """Whether the responses to candidates are few enough to come from another process."""
    return sum(len(c.effect.sizes) for c in shaped) * run.whitened.size <= MOST_SENT


def _in_one_model(
    null: Null,
    run: NullObserver,
    explicit: ExplicitModel,
    pairs: Sequence[tuple[Candidate, Candidate]],
) -> _Responding:
    """Pairs of a candidate that `explicit` contains, without states of its own, and one of its shapes."""
    kept, refused = with_possible_values([shaped for _, shaped in pairs])
    if not kept:
        return _Responding((), np.zeros((0, run.whitened.size)), refused)
    base = {shaped.name: candidate for candidate, shaped in pairs}
    sizes = _sizes_in(explicit, [(base[one.name], one) for one in kept])
    return _Responding(kept, _responses_to(null, run, explicit, sizes), refused)


def _sizes_in(explicit: ExplicitModel, pairs: Sequence[tuple[Candidate, Candidate]]) -> Sizes:
    """The sizes of shaped candidates in a model that contains each once: at the parameters of their shapes,
    of which a value holds one of every effect."""
    column = {p.name: i for i, p in enumerate(explicit.flat.parameters)}
    names: list[str] = []
    at: list[int] = []
    values = [explicit.flat.theta_values.copy()]
    numbers: dict[str, int] = {}
    for candidate, shaped in pairs:
        number = numbers[candidate.name] = numbers.get(candidate.name, -1) + 1
        if number == len(values):
            values.append(explicit.flat.theta_values.copy())
        for name, value in shaped.shape.items():
            values[number][column[f"{candidate.name}.{name}"]] = value
        names += size_names(candidate)
        at += [number] * len(candidate.effect.sizes)
    return Sizes(tuple(names), np.array(at, dtype=int), np.array(values))


def _in_own_components(null: Null, run: NullObserver, shaped: Sequence[Candidate]) -> _Responding:
    usable, refused, explicit = attachable(null.flat, shaped) if shaped else ((), (), null.explicit)
    if not usable:
        return _Responding((), np.zeros((0, run.whitened.size)), refused)
    names = [name for c in usable for name in size_names(c)]
    try:
        responses = _responses_to(null, run, explicit, sizes_of(explicit, names))
    except RuntimeError:  # a loop of equations that has no solution along the recordings
        if len(usable) == 1:
            refused = (*refused, (usable[0].label, NO_SOLUTION))
            return _Responding((), np.zeros((0, run.whitened.size)), refused)
        middle = len(usable) // 2
        parts = [_in_own_components(null, run, half) for half in (usable[:middle], usable[middle:])]
        return _in_order([c.name for c in usable], parts, refused)
    return _Responding(usable, responses, refused)


def _responses_to(null: Null, run: NullObserver, explicit: ExplicitModel, sizes: Sizes) -> np.ndarray:
    """Responses (k, m) of the whitened innovations to the sizes; none to those that only rescale."""
    moved = _moved(null, run, explicit)
    responses = _responses(null, run, explicit, sizes, moved)
    responses[_only_rescales(null, explicit, sizes, moved)] = 0.0
    return responses


def _in_order(
    names: Sequence[str], parts: Sequence[_Responding], refused: Sequence[tuple[str, str]]
) -> _Responding:
    """The parts as one, their candidates in the order of `names`."""
    candidates = [c for part in parts for c in part.candidates]
    ends = np.cumsum([0, *(len(c.effect.sizes) for c in candidates)]).tolist()
    place = {name: i for i, name in enumerate(names)}
    order = sorted(range(len(candidates)), key=lambda i: place[candidates[i].name])
    rows = [row for i in order for row in range(ends[i], ends[i + 1])]
    responses = np.concatenate([part.responses for part in parts])[rows]
    whole = tuple(chain(refused, *(part.refused for part in parts)))
    return _Responding(tuple(candidates[i] for i in order), responses, whole)


def already_there(null: Null, candidates: Sequence[Candidate]) -> list[str]:
    """Of every candidate, which component of the model says what a second one at the same place would say:
    one with the same equations whose parameters are estimated, or the limit of a sensor that is seen to clip.
    Empty where there is none."""
    fitted = {name.partition(".")[0] for name in null.estimated}
    found = components_with(null.flat, [(c.effect, c.site) for c in candidates])
    peers = [
        next((name for name in names if name in fitted or name.startswith(CLIPPED)), "") for names in found
    ]
    return [f"the model contains it already: `{peer}`" if peer else "" for peer in peers]


def loads_rescaled(null: Null, run: NullObserver) -> np.ndarray:
    """Responses (n_loads, m) of the whitened innovations to loads that grow in proportion.

    What only rescales estimated parameters rescales the unknown loads with them, which the observer holds to
    its gain: an input gain, say, is the inverse of all inertias, dampings and springs, and of the loads."""
    parts = []
    for number, (experiment, observed) in enumerate(zip(null.experiments, run.observed, strict=True)):
        rows = [run.state_names.index(load.name) for load in null.loads]
        drives = np.zeros((len(rows), 2, experiment.n_samples - 1, len(run.state_names)))
        for i, row in enumerate(rows):
            entry = run.average.A[:, row].copy()
            entry[row] = 0.0  # the load's own decay
            course = np.stack([observed.filtered[:-1, row], observed.predicted[1:, row]])
            drives[i] = course[..., None] * entry
        parts.append(innovation_responses(run, number, experiment, drives))
    return np.concatenate(parts, axis=1)


def nuisance(run: NullObserver, n_parameters: int) -> np.ndarray:
    """Slopes over the parameters (common to all experiments) and over each experiment's initial state.
    Shapes: (n_parameters + n_experiments n_states, m) for m whitened errors."""
    parameters = np.concatenate(
        [o.slopes[:n_parameters].reshape(n_parameters, o.slopes[0].size) for o in run.observed], axis=1
    )
    parts, total, first = [parameters], parameters.shape[1], 0
    for one in run.observed:
        own = one.slopes[n_parameters:].reshape(one.slopes.shape[0] - n_parameters, -1)
        table = np.zeros((own.shape[0], total))
        table[:, first : first + own.shape[1]] = own
        parts.append(table)
        first += own.shape[1]
    return np.vstack(parts)


def size_names(candidate: Candidate) -> tuple[str, ...]:
    """The model's names of the parameters that make the effect vanish."""
    return tuple(f"{candidate.name}.{p.name}" for p in candidate.effect.sizes)


def _responses(
    null: Null, run: NullObserver, explicit: ExplicitModel, sizes: Sizes, moved: _Moved | None = None
) -> np.ndarray:
    """Responses (k, m) of the whitened innovations to each of the sizes."""
    parts, k = [], len(sizes.names)
    for number, entries in enumerate(entries_along(null, run, explicit, sizes, moved)):
        experiment = null.experiments[number]
        rows = np.empty((k, experiment.outputs.size))
        for several in some_at_a_time(k, experiment.n_samples * entries.n_states):
            ends, shown = entries.of(several)
            rows[several] = innovation_responses(run, number, experiment, ends, shown)
        parts.append(rows)
    return np.concatenate(parts, axis=1)


@dataclass(frozen=True)
class Entries:
    """Where parameters enter the model along one recording: what each does to the rates of the `n_states`
    states, at the start and at the end of every interval, and to the `n_outputs` outputs at every sample."""

    at_starts: _Drives
    at_ends: _Drives
    direct: _Drives
    n_states: int
    n_outputs: int

    def of(self, several: range) -> tuple[np.ndarray, np.ndarray]:
        """Of some of the parameters: (k, 2, n_samples - 1, n_states) and (k, n_samples, n_outputs)."""
        ends = [
            self.at_starts.of(several, slice(0, -1), self.n_states),
            self.at_ends.of(several, slice(1, None), self.n_states),
        ]
        return np.stack(ends, axis=1), self.direct.of(several, slice(None), self.n_outputs)


@dataclass(frozen=True)
class _Motion:
    """The states (n_samples, n) of a model with effects along one recording, as the null's observer has them
    after and before the outputs of a sample, and inputs with their slopes, u (n_u, n_samples) and v (n_v,
    n_samples), at the start of the interval after a sample and at the end of the one before it."""

    filtered: np.ndarray
    predicted: np.ndarray
    first: Inputs
    last: Inputs


@dataclass(frozen=True)
class _Moved:
    """The `motions` of a model along the recordings, and how its states follow from those of the null."""

    grown: GrownStates
    motions: tuple[_Motion, ...]


def _moved(null: Null, run: NullObserver, explicit: ExplicitModel) -> _Moved:
    grown = _grown(null, run, explicit)
    motions = []
    for experiment, observed in zip(null.experiments, run.observed, strict=True):
        first, last = _driven_inputs(null, explicit, experiment)
        filtered, predicted = (
            grown.along(experiment.time, x, first) for x in (observed.filtered, observed.predicted)
        )
        motions.append(_Motion(filtered, predicted, first, last))
    return _Moved(grown, tuple(motions))


def entries_along(
    null: Null, run: NullObserver, explicit: ExplicitModel, sizes: Sizes, moved: _Moved | None = None
) -> Iterator[Entries]:
    """How the sizes enter `explicit`, for each experiment, along the states of the null's
    observer: the filtered ones, and at the end of an interval the predicted ones, since what an effect does
    to an innovation must not know that innovation."""
    moved = moved or _moved(null, run, explicit)
    back = moved.grown.rows_without_effects()
    of_rates, of_outputs = _drive_functions(explicit, sizes, back)
    for experiment, motion in zip(null.experiments, moved.motions, strict=True):
        yield Entries(
            at_starts=_drives(of_rates, experiment.time, motion.filtered, motion.first),
            at_ends=_drives(of_rates, experiment.time, motion.predicted, motion.last),
            direct=_drives(of_outputs, experiment.time, motion.predicted, motion.last),
            n_states=back.shape[1],
            n_outputs=len(null.flat.outputs),
        )


def some_at_a_time(count: int, each: int) -> Iterator[range]:
    """`count` things of `each` numbers, so many at a time that their numbers stay in the memory that is at
    hand: all at once, most of the time goes into getting more of it."""
    length = max(1, AT_HAND // each)
    return (range(begin, min(begin + length, count)) for begin in range(0, count, length))


def _only_rescales(null: Null, explicit: ExplicitModel, sizes: Sizes, moved: _Moved) -> np.ndarray:
    """Which sizes (k,) do what the estimated parameters and the loads do already."""
    motion, loads = moved.motions[0], [load.name for load in null.loads]
    inputs, derivatives = (part.T for part in motion.first)
    return rescaling_sizes(explicit, sizes, null.estimated, loads, motion.filtered, inputs, derivatives)


def law_response(
    null: Null, run: NullObserver, candidate: Candidate, theta: Mapping[str, float]
) -> np.ndarray:
    """Response (1, m) of the whitened innovations to an effect with the sizes and shape of `theta`. Raises
    what attaching raises, for effects that have no derivative at size zero too."""
    effect = candidate.effect
    shape = {name: theta.get(f"{candidate.name}.{name}", value) for name, value in candidate.shape.items()}
    placed = replace(candidate, shape=shape)
    explicit = explicit_at_null(null.flat, [placed])
    responses = _responses(null, run, explicit, sizes_of(explicit, size_names(placed)))
    weights = [theta.get(f"{candidate.name}.{p.name}", 0.0) - (p.null or 0.0) for p in effect.sizes]
    return np.array(weights)[None] @ responses


def innovation_responses(
    run: NullObserver, number: int, experiment: Experiment, g: np.ndarray, direct: np.ndarray | None = None
) -> np.ndarray:
    """Responses (k, n_samples · n_y) of the whitened innovations of an experiment to drives g (k, 2,
    n_samples - 1, n) of the states' rates at the starts and ends of its intervals, and `direct` (k,
    n_samples, n_y) of the outputs, through the observer's error dynamics."""
    return _whitened(run, experiment, run.dynamics[number].errors(g, direct))


def responses_along(
    run: NullObserver, number: int, experiment: Experiment, courses: np.ndarray, entry: np.ndarray
) -> np.ndarray:
    """`innovation_responses` (k, n_samples · n_y) to drives of courses (k, 2, n_samples - 1) that enter the
    rates by one and the same `entry` (n,)."""
    return _whitened(run, experiment, run.dynamics[number].errors_along(courses, entry))


def _whitened(run: NullObserver, experiment: Experiment, change: np.ndarray) -> np.ndarray:
    """Changes (k, n_samples, n_y) of the innovations of an experiment, whitened, (k, n_samples · n_y)."""
    change = np.where(np.isfinite(experiment.outputs), change, 0.0)
    return (change @ turned(run.root)).reshape(change.shape[0], -1)


def _drive_functions(
    explicit: ExplicitModel, sizes: Sizes, back: np.ndarray
) -> tuple[ca.Function, ca.Function]:
    """(x, u, v, t) -> ∂f/∂sizes (n, k) of the states without effects, and ∂h/∂sizes (n_y, k), both sparse, at
    parameters of the model: most of what effects of size zero would do to each other is nothing then. The
    rates of the states with effects times `back` (n_rows, n) are those of the states without."""
    n_x, n_u, n_v, n_w, n_theta = (explicit.rhs.numel_in(i) for i in range(5))
    x, u, v = ca.SX.sym("x", n_x), ca.SX.sym("u", n_u), ca.SX.sym("v", n_v)
    theta, t, w = ca.SX.sym("theta", n_theta), ca.SX.sym("t"), ca.SX.zeros(n_w)
    f, h = explicit.rhs(x, u, v, w, theta, t), explicit.outputs(x, u, v, w, theta, t)

    def slopes(law: ca.SX) -> ca.Function:
        there = ca.sparsify(slopes_over(explicit, law, theta, sizes))
        # What stands in the laws of many effects is found once.
        return ca.Function("drives", [x, u, v, t], ca.cse([there]))

    return slopes(ca.mtimes(ca.sparsify(ca.DM(back.T)), f)), slopes(h)


def _driven_inputs(null: Null, explicit: ExplicitModel, experiment: Experiment) -> tuple[Inputs, Inputs]:
    """u (n_u, n_samples) and v (n_v, n_samples) of the model with effects at the start of the interval after
    every sample and at the end of the one before it. Effects may need slopes of inputs that the model without
    them does not: a body that takes up heat does where its temperature is an input."""
    known = len(experiment.input_names)
    added = [np.nan_to_num(experiment.extra[v.name]) for v in explicit.flat.inputs[known:]]
    whole = np.column_stack([experiment.inputs, *added])
    u0, u1 = inputs_at_ends(explicit, experiment.time, whole, null.hold)
    n_u = whole.shape[1]
    first, last = np.vstack([u0, u1[-1:]]), np.vstack([u0[:1], u1])
    return (first[:, :n_u].T, first[:, n_u:].T), (last[:, :n_u].T, last[:, n_u:].T)


@dataclass(frozen=True)
class _Drives:
    """Values (n_nonzeros, n_samples) of a drive function along a recording, and for each its row among the
    rates or outputs and its column among the k sizes."""

    values: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    def of(self, sizes: range, samples: slice, n_rows: int) -> np.ndarray:
        """The drives (len(sizes), n_samples, n_rows) of some sizes at some samples."""
        values = self.values[:, samples]
        found = np.zeros((len(sizes), values.shape[1], n_rows))
        for place in range(*np.searchsorted(self.columns, [sizes.start, sizes.stop])):
            found[self.columns[place] - sizes.start, :, self.rows[place]] = values[place]
        return found


def _drives(drives: ca.Function, time: np.ndarray, states: np.ndarray, inputs: Inputs) -> _Drives:
    """A drive function along the states (n_samples, n) of the model that it is of."""
    pattern = drives.sparsity_out(0)
    values = np.zeros((0, time.size))
    if pattern.nnz():
        columns = [states, inputs[0].T, inputs[1].T, time[:, None]]
        values = np.ascontiguousarray(along(drives, columns)[0].T)
    if not np.isfinite(np.sum(values)):
        np.nan_to_num(values, copy=False)
    rows, places = (np.array(part, dtype=int) for part in pattern.get_triplet())
    return _Drives(values, rows, places)


def scored(
    candidates: Sequence[Candidate],
    rows: Sequence[slice],
    white: np.ndarray,
    directions: np.ndarray,
    rescaling: np.ndarray,
    responses: np.ndarray,
    skipped: tuple[tuple[str, str], ...],
    seed: int,
    absorbed_share: float = GATES.absorbed_share,
) -> Screen:
    """The screen of candidates with `rows` of responses (k, m) to their sizes, tried on white residuals
    (m,) beyond `directions` (d, m) of the parameters, which absorb a response that keeps no more than that
    share beyond them, or beyond what `rescaling` (e, m) changes besides."""
    rest, share = projected(responses, directions)
    norms = np.linalg.norm(rest, axis=1)
    only_rescales = projected(responses, rescaling)[1] < absorbed_share
    seen = (share >= absorbed_share) & ~only_rescales & (norms > 0.0)
    unit = np.where(seen[:, None], rest / np.where(norms > 0.0, norms, 1.0)[:, None], 0.0)
    spread = spread_under(white)(unit)
    z = np.where(seen, unit @ white / spread, 0.0)
    correlation = unit @ unit.T
    tests = [_Test(c, r, correlation, seen) for c, r in zip(candidates, rows, strict=True)]
    scores = np.array([float(test.score(z[None])[0]) for test in tests])
    largest = _largest(tests, correlation, seed)
    level = float(np.quantile(largest, 0.95))
    entries = []
    for test, score in zip(tests, scores, strict=True):
        own = norms[test.rows]
        size = test.estimate(z) * spread[test.rows] / np.where(own > 0.0, own, 1.0)
        null_values = np.array(list(test.candidate.effect.null_values.values()))
        detectable = (level + norm.ppf(GATES.stated_power)) * np.min(
            spread[test.rows] / np.where(own > 0.0, own, np.inf)
        )
        entries.append(
            Screened(
                candidate=test.candidate,
                score=float(score),
                sizes=tuple((null_values + size).tolist()),
                # Bonferroni's bound for what was compared before the screen.
                p_value=min(1.0, test.candidate.searched * _p_value(float(score), largest))
                if test.is_seen
                else 1.0,
                absorbed=not test.is_seen,
                detectable=float(detectable) if detectable > 0.0 else np.inf,
                size_error=float(spread[test.rows][0] / own[0]) if seen[test.rows][0] else 0.0,
            )
        )
    order = np.argsort([-e.score for e in entries])
    leading = [r.start for r in rows]
    between = correlation[np.ix_(leading, leading)][np.ix_(order, order)]
    found = tuple(entries[i] for i in order)
    p_value = min((e.p_value for e in found), default=1.0)
    return Screen(found, between, p_value, len(candidates), skipped)


@dataclass(frozen=True)
class ScoredValue:
    """A parameter of the model that is not estimated: the magnitude of the score of another value, its
    p-value corrected for their number, and others of them whose values do the same to the innovations."""

    name: str
    score: float
    p_value: float
    alike: tuple[str, ...] = ()


def value_scores(null: Null, run: NullObserver, names: Sequence[str]) -> list[ScoredValue]:
    """How much another value of each of the parameters would show, most first. Nothing where estimated
    parameters and other loads do the same."""
    responses = _responses_to(null, run, null.explicit, sizes_of(null.explicit, names))
    directions = nuisance(run, len(null.estimated))
    rest, share = projected(responses, directions)
    only_rescales = projected(responses, np.vstack([directions, loads_rescaled(null, run)]))[1]
    norms = np.linalg.norm(rest, axis=1)
    seen = (np.minimum(share, only_rescales) >= GATES.absorbed_value) & (norms > 0.0)
    unit = np.where(seen[:, None], rest / np.where(norms > 0.0, norms, 1.0)[:, None], 0.0)
    z = np.where(seen, np.abs(unit @ run.whitened) / spread_under(run.whitened)(unit), 0.0)
    same = np.abs(unit @ unit.T) > GATES.same_place_correlation
    found = [
        ScoredValue(
            name,
            float(z[i]),
            float(min(1.0, 2.0 * len(names) * norm.sf(z[i]))),
            tuple(other for j, other in enumerate(names) if j != i and same[i, j]),
        )
        for i, name in enumerate(names)
    ]
    return sorted(found, key=lambda one: -one.score)


def promising_pairs(found: Screen) -> list[tuple[Screened, Screened]]:
    """Pairs of candidates of one size each whose joint score says much more than any of all candidates alone,
    and more than a search over all pairs finds by chance; the best first, with their sizes beside each other:
    of two that hide each other, one may seem to have the wrong sign alone. One effect with two shapes at one
    place is no pair: a model holds it once.

    The scores z of two responses with the correlation ρ have the joint statistic
    (z₁² + z₂² - 2ρ z₁z₂)/(1 - ρ²), chi-squared with two degrees of freedom where nothing is missing."""
    chosen = [i for i, e in enumerate(found.entries) if not e.absorbed and len(e.candidate.effect.sizes) == 1]
    entries = [found.entries[i] for i in chosen]
    if len(entries) < 2:
        return []
    sizes = [e.candidate.effect.sizes[0] for e in entries]
    nulls = np.array([p.null or 0.0 for p in sizes])
    errors = np.array([e.size_error for e in entries])
    z = np.array([e.deviation for e in entries])
    rho = found.correlation[np.ix_(chosen, chosen)]
    away = np.maximum(1.0 - rho**2, float(np.finfo(float).eps))
    joint = (z[:, None] ** 2 + z[None] ** 2 - 2.0 * rho * z[:, None] * z[None]) / away
    beside = (z[:, None] - rho * z[None]) / away  # the size of the first beside the second, in its errors
    one_sided = np.array([p.min is not None and p.min >= null for p, null in zip(sizes, nulls, strict=True)])
    possible = ~one_sided[:, None] | (beside > 0.0)
    labels = np.array([e.candidate.label for e in entries])
    possible &= possible.T & (np.abs(rho) < GATES.same_place_correlation) & (labels[:, None] != labels[None])
    n_pairs = len(entries) * (len(entries) - 1) // 2
    alone = max(e.score for e in found.entries) ** 2
    possible &= 0.5 * (joint - alone) > GATES.min_bic_gain
    possible &= n_pairs * chi2.sf(joint, 2) < GATES.missing_level
    pairs = [(i, j) for i, j in zip(*np.nonzero(np.triu(possible, 1)), strict=True)]
    pairs.sort(key=lambda pair: -joint[pair])
    sizes_beside = nulls[:, None] + beside * errors[:, None]

    def at(i: int, j: int) -> Screened:
        return replace(entries[i], sizes=(float(sizes_beside[i, j]),))

    return [(at(i, j), at(j, i)) for i, j in pairs]


class _Test:
    """The score test of one candidate: its rows, and the sign that physics allows its size."""

    def __init__(self, candidate: Candidate, rows: slice, correlation: np.ndarray, seen: np.ndarray) -> None:
        self.candidate = candidate
        self.rows = rows
        self.is_seen = bool(np.any(seen[rows]))
        sizes = candidate.effect.sizes
        self.is_one_sided = (
            len(sizes) == 1 and sizes[0].min is not None and sizes[0].min >= (sizes[0].null or 0.0)
        )
        block = correlation[rows, rows]
        self._inverse = np.linalg.pinv(block, hermitian=True) if self.is_seen else np.zeros_like(block)
        self._degrees = max(int(np.sum(seen[rows])), 1)

    def score(self, z: np.ndarray) -> np.ndarray:
        """Standard-normal equivalent (≥ 0) of draws z (n_draws, k)."""
        own = z[:, self.rows]
        if self._degrees == 1:
            value = own[:, 0] if own.shape[1] == 1 else np.max(np.abs(own), axis=1)
            return np.maximum(value, 0.0) if self.is_one_sided else np.abs(value)
        statistic = np.einsum("di,ij,dj->d", own, self._inverse, own)
        log_tail = chi2.logsf(statistic, self._degrees)
        return np.where(
            np.isfinite(log_tail),
            np.maximum(-ndtri_exp(np.minimum(log_tail - np.log(2.0), -0.7)), 0.0),
            np.sqrt(statistic),
        )

    def estimate(self, z: np.ndarray) -> np.ndarray:
        """One-step estimate of the sizes in standard errors of each alone."""
        return self._inverse @ z[self.rows]


def projected(responses: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Responses with what the nuisance directions explain removed, and the share that is left of each.
    Shapes: responses (k, m), directions (d, m); shares (k,)."""
    return projection(directions)(responses)


def projection(directions: np.ndarray) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """`projected` for the same directions (d, m) time and again."""
    scale = np.linalg.norm(directions, axis=1)
    used = directions[scale > 0.0] / scale[scale > 0.0, None]
    values, vectors = np.linalg.eigh(used @ used.T)
    kept = values > GATES.nuisance_rank**2 * values.max(initial=0.0)
    basis = (vectors[:, kept] / np.sqrt(values[kept])).T @ used

    def apart(responses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rest = responses - (responses @ basis.T) @ basis
        size = np.linalg.norm(responses, axis=1)
        return rest, np.linalg.norm(rest, axis=1) / np.where(size > 0.0, size, 1.0)

    return apart


def spread_under(white: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Standard deviation (k,) of the scores of unit responses (k, m) under the spectrum of the innovations
    (m,) themselves: 1 where they are white."""
    coefficients, cov = autoregression(white[:, None])
    if coefficients.shape[0] == 0:
        return lambda unit: np.full(unit.shape[0], np.sqrt(cov[0, 0]))
    length = 2 * int(2 ** np.ceil(np.log2(white.size)))
    frequencies = np.arange(length // 2 + 1) / length
    delays = np.exp(-2j * np.pi * np.outer(frequencies, np.arange(1, coefficients.shape[0] + 1)))
    density = cov[0, 0] / np.abs(1.0 - delays @ coefficients[:, 0, 0]) ** 2
    weights = np.full(frequencies.size, 2.0)
    weights[0] = weights[-1] = 1.0
    weights *= density

    def spread(unit: np.ndarray) -> np.ndarray:
        variance = [np.abs(np.fft.rfft(row, length)) ** 2 @ weights / length for row in unit]
        return np.sqrt(np.maximum(variance, 1e-12))

    return spread


def _largest(tests: Sequence[_Test], correlation: np.ndarray, seed: int) -> np.ndarray:
    """Draws of the largest score under the null, sorted."""
    values, vectors = np.linalg.eigh(correlation)
    kept = values > 1e-10 * values.max(initial=0.0)
    root = vectors[:, kept] * np.sqrt(values[kept])
    # Draw by draw beside each other for every test, which reads its own rows one after the other.
    draws = (root @ np.random.default_rng(seed).standard_normal((DRAWS, root.shape[1])).T).T
    most = np.zeros(DRAWS)
    for test in tests:
        if test.is_seen:
            np.maximum(most, test.score(draws), out=most)
    return np.sort(most)


def _p_value(score: float, largest: np.ndarray) -> float:
    """Corrected p-value; beyond the highest draws, Bonferroni's bound with the number of candidates at which
    it meets the share of draws above the first of them."""
    above = largest.size - int(np.searchsorted(largest, score))
    if above >= TAIL:
        return above / largest.size
    meeting = float(largest[-TAIL])
    share = TAIL / largest.size
    return float(min(share, share * norm.sf(score) / norm.sf(meeting)))
