"""Where a simulation of data that a model was not fitted to begins: at the state that fits them best."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import RTOL
from daest.estimation.fitting.records import longest_duration, n_observed
from daest.estimation.linear.delay_starts import long_past_of
from daest.model.experiment import Experiment
from daest.model.flat import ExplicitModel, FlatModel
from daest.systems.events.integration import Correction, IntegrationError, Trajectory
from daest.systems.reduction.initialize import initial_point
from daest.systems.simulation.integrate import AffineIntegrator, Integrator, integrate, integrator

START_SAMPLES = 300  # that the initial state is fitted to
START_PARTS = (0.02, 0.07, 0.25, 1.0)  # of these: windows over which the search for it grows
FEWEST_AT_START = 4  # samples of such a window
LONGER = 2  # times as long is the next window, as long as the observer remembers the start
START_ITERATIONS = 15
CONSTANT = 1e6  # durations, the time constant of a load that keeps its value


def free_runs(null: Null, experiments: Sequence[Experiment]) -> tuple[Trajectory, ...] | None:
    """The simulation of every experiment, from the initial state that fits its first samples best, loads at
    rest; None where the model cannot be simulated."""
    model = integrator(null.explicit)
    still = np.zeros((len(null.explicit.state_names), len(null.flat.outputs)))
    root = np.diag(1.0 / null.measurement_std)
    runs = []
    for experiment in experiments:
        try:
            x0 = best_start(null, model, experiment, still, root)
            runs.append(
                integrate(
                    model, experiment.time, experiment.inputs, null.theta, x0, hold=null.hold, rtol=RTOL
                )
            )
        except IntegrationError:
            return None
    return tuple(runs)


def misfit(
    null: Null, experiments: Sequence[Experiment], std: np.ndarray, resting: str | None = None
) -> float | None:
    """Sum of the squared errors of the simulation of a model, relative to the `std` (n_y,) of its outputs,
    where every experiment has an initial state of its own, loads at rest; with those states at rest, too,
    that belong to the component `resting`. None where it cannot be simulated."""
    loads = {load.name for load in null.loads}
    names = null.explicit.state_names
    free = np.array([name not in loads and name.partition(".")[0] != resting for name in names])
    free &= ~_shaped(null, experiments)

    def begun(experiment: Experiment) -> np.ndarray:
        return np.where(free, initial_point(null.explicit, null.theta, experiment.inputs[0])[0], 0.0)

    return _squared_errors(null, integrator(null.explicit), experiments, np.diag(1.0 / std), free, begun)


def _squared_errors(
    null: Null,
    model: Integrator,
    experiments: Iterable[Experiment],
    root: np.ndarray,
    free: np.ndarray,
    begun: Callable[[Experiment], np.ndarray],
) -> float | None:
    """Sum of the squared errors, whitened with the `root` (n_y, n_y), of simulations that start where the
    states that are `free` (n,) fit the whole experiment best, searched from where it has `begun`. None where
    one of them cannot be simulated."""
    gain, total = np.zeros((free.size, len(null.flat.outputs))), 0.0
    for experiment in experiments:
        try:
            begin = begun(experiment)
        except IntegrationError:
            return None
        found = _searched_start(null, model, experiment, gain, root, begin, free, experiment.n_samples)
        total += found.error * n_observed([experiment])
    return total if np.isfinite(total) else None


def steady_misfit(
    null: Null, flat: FlatModel, explicit: ExplicitModel, experiments: Sequence[Experiment]
) -> float | None:
    """Mean squared error of the simulation of `flat`, whose dynamics are `explicit`, whitened with the noise
    of the `null`'s sensors, where every experiment has a constant load and an initial state of its own.
    Inputs that the model has not are ignored, further ones are columns of `extra`. None where it cannot be
    simulated.

    From one recording to the next a room is warmer, the zero of a sensor elsewhere, a bearing tighter: that
    much of the error belongs to no law, and hides what a law does.
    """
    forever = CONSTANT * longest_duration(experiments)
    lasting = flat.with_theta({f"{load.name}.T": forever for load in null.loads})
    still = replace(null, flat=lasting, explicit=replace(explicit, flat=lasting))
    model = integrator(still.explicit)
    root, free = np.diag(1.0 / null.measurement_std), ~_shaped(still, experiments)
    gain = np.zeros((free.size, len(flat.outputs)))
    names = flat.input_names
    driving = (one.as_driving(names) for one in experiments)
    begun = partial(best_start, still, model, gain=gain, root=root)
    return _squared_errors(still, model, driving, root, free, begun)


def best_start(
    null: Null, model: Integrator, experiment: Experiment, gain: np.ndarray, root: np.ndarray
) -> np.ndarray:
    """The state at the first sample that the observer follows the data from best, loads at rest: by errors
    whitened with the `root` (n_y, n_y). That is of the innovations where there is a gain: a fit with hardly
    any load needs no measurement, and leaves the noise of a sensor open, be it beyond all that it shows.

    It is looked for from the model's start at once, and over windows that grow: over a short one a law that
    bends or sticks hardly matters, so that what it finds is near. An affine model has one optimum, which the
    first step comes to from anywhere. Where hardly any load is left, the observer does not correct anything
    and the start decides over all that follows: the window grows with it.
    """
    begin = initial_point(null.explicit, null.theta, experiment.inputs[0])[0]
    loads = {load.name for load in null.loads}
    free = np.array([name not in loads for name in null.explicit.state_names])
    free &= ~_shaped(null, [experiment])
    begin = np.where(free, begin, 0.0)
    n = min(START_SAMPLES, experiment.n_samples)
    best = _searched_start(null, model, experiment, gain, root, begin, free, n)
    if not (isinstance(model, AffineIntegrator) and np.isfinite(best.error)):
        grown = _Start(begin)
        for part in START_PARTS:
            rows = max(int(part * n), FEWEST_AT_START)
            grown = _searched_start(null, model, experiment, gain, root, grown.state, free, rows)
        best = min(best, grown, key=lambda found: found.error)
    while n < experiment.n_samples and best.remembered > GATES.max_remembered:
        n = min(LONGER * n, experiment.n_samples)
        best = _searched_start(null, model, experiment, gain, root, best.state, free, n)
    return best.state


def _shaped(null: Null, experiments: Sequence[Experiment]) -> np.ndarray:
    """The states (n,) that hold a curve which a long delay would keep from before a recording: as free as
    they are they would do what the data do."""
    return np.any([long_past_of(null.explicit, null.theta, e) for e in experiments], axis=0)


@dataclass(frozen=True)
class _Start:
    """A state (n_x,) to begin with, its mean squared whitened error over a window, and what it does to the
    outputs at the end of that relative to what it does at most."""

    state: np.ndarray
    error: float = np.inf
    remembered: float = 0.0


def _searched_start(
    null: Null,
    model: Integrator,
    experiment: Experiment,
    gain: np.ndarray,
    root: np.ndarray,
    begin: np.ndarray,
    free: np.ndarray,
    n: int,
) -> _Start:
    """The state found from `begin` by Gauss-Newton in the states that are `free` over the first n samples,
    whose errors are whitened with the `root`."""
    time, inputs, y = experiment.time[:n], experiment.inputs[:n], experiment.outputs[:n]
    best, step = _Start(begin), np.zeros(begin.size)
    for _ in range(START_ITERATIONS):
        try:
            run = integrate(
                model, time, inputs, null.theta, best.state + step, hold=null.hold, sensitivities=True,
                correction=Correction(y, gain), rtol=RTOL,
            )  # fmt: skip
        except IntegrationError:
            step = 0.5 * step
            continue
        seen = np.isfinite(y - run.outputs)
        error = np.where(seen, y - run.outputs, 0.0) @ root.T
        value = float(np.sum(error**2)) / seen.sum() if seen.any() else np.inf
        if value >= best.error:  # a law that bends lets whole steps miss
            step = 0.5 * step
            continue
        is_there = value > (1.0 - GATES.unseen_start_progress) * best.error
        slopes = root @ np.where(seen[:, :, None], run.sensitivities[:, :, free], 0.0)
        # A root at zero, or a law that has run away, has a value and no slope.
        has_slopes = bool(np.all(np.isfinite(slopes)))
        best = _Start(best.state + step, value, _share_at_end(slopes) if has_slopes else 0.0)
        if is_there or not has_slopes:
            break
        step = np.zeros(begin.size)
        step[free] = np.linalg.lstsq(slopes.reshape(error.size, -1), error.ravel(), rcond=1e-8)[0]
    return best


def _share_at_end(slopes: np.ndarray) -> float:
    """The size of slopes (n, n_y, n_free) in the last tenth of the samples relative to the largest one."""
    sizes = np.linalg.norm(slopes, axis=(1, 2))
    largest = float(np.max(sizes, initial=0.0))
    return float(np.max(sizes[-max(sizes.size // 10, 1) :])) / largest if largest > 0.0 else 0.0
