"""The observer of the null along its recordings: filtered states, innovations and what these are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.error_dynamics import MOST_STATES, WatchedErrors, dynamics_along
from daest.diagnosis.null_model.null import Null, grows_beyond
from daest.estimation.fitting.records import RUN_LENGTHS, part_of
from daest.estimation.nonlinear.observer import AverageModel, average_model, observer
from daest.model.experiment import Experiment
from daest.numerics.tables import turned
from daest.systems.events.integration import Correction, IntegrationError, Trajectory
from daest.systems.simulation.integrate import Integrator, integrate, integrator, interval_inputs
from daest.systems.simulation.sensor_laws import slopes_along
from daest.systems.tolerances import SOLVER

RTOL = 1e-4  # of a run of an observer: that of the refits, ...
ATOL_OF_SCALE = 0.1  # ... with their absolute tolerance where the sizes of the states are known
LOUDER = tuple(10.0**power for power in range(0, 40, 2))  # loads, until an observer exists
LEAST_INTENSITY = 1e-30  # of a load that is none, from which that search begins
HALVINGS = 8  # of a gain with which the observer runs away


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
