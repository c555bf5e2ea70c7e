"""Responses of the innovations to small sizes of effects, and to what the null estimates.

The derivative of the model with respect to a size, evaluated on filtered variables, drives the error dynamics
of the null's observer: that is the response of the innovations to the effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.absorbed import rescaling_sizes
from daest.diagnosis.screening.candidates import explicit_at_null
from daest.diagnosis.screening.grown_states import GrownStates, Inputs, grown_states
from daest.diagnosis.screening.size_slopes import Sizes, sizes_of, slopes_over
from daest.model.diagnosis import Candidate
from daest.model.experiment import Experiment
from daest.model.flat import ExplicitModel
from daest.numerics.evaluator import along
from daest.numerics.tables import turned
from daest.systems.simulation.integrate import inputs_at_ends

AT_HAND = 1 << 20  # numbers (8 MiB) of the responses that are made at a time


def grown_along(null: Null, run: NullObserver, explicit: ExplicitModel) -> GrownStates:
    """How the states of a model with effects follow from those of the model, in the middle of a recording."""
    states, inputs = run.observed[0].filtered.mean(axis=0), null.experiments[0].inputs.mean(axis=0)
    return grown_states(null.explicit, null.theta, states, inputs, explicit)


def responses_to(null: Null, run: NullObserver, explicit: ExplicitModel, sizes: Sizes) -> np.ndarray:
    """Responses (k, m) of the whitened innovations to the sizes; none to those that only rescale."""
    moved = _moved(null, run, explicit)
    responses = _responses(null, run, explicit, sizes, moved)
    responses[_only_rescales(null, explicit, sizes, moved)] = 0.0
    return responses


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
    grown = grown_along(null, run, explicit)
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
