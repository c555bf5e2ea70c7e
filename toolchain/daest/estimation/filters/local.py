"""A recording prepared for the filters of nonlinear models: extended, unscented and particle.

Where a choice of states would become singular on the way, all differentiated variables are states and every
estimate is projected onto the constraints. The step of the local linearisation is halved until the estimate
no longer changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines.ekf import run_ekf
from daest.estimation.filter_engines.filter_task import Noise, Record, Start, Task, record
from daest.estimation.filter_engines.interpreted import project
from daest.estimation.filter_engines.nonlinear_smoother import smooth_ekf
from daest.estimation.filters.case import Case
from daest.estimation.fitting.records import in_model_order
from daest.estimation.gates import FIT
from daest.model.estimates import InitialState
from daest.model.flat import Dynamics, ExplicitModel
from daest.model.holds import Hold
from daest.systems.events.event_functions import EventFunctions
from daest.systems.events.event_update import settled_start
from daest.systems.events.integration import IntegrationError
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.redundant import good_everywhere, matching_states
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.local_linear import local_model

MOST_SUBSTEPS = 64  # per median sample interval
TINY = np.finfo(float).tiny
MODES_FOLLOWED = (
    "The model has events: the filter follows each of them, covariances pass it with the slopes of the "
    "jump, and its mode is that of the estimate."
)
START_SAMPLES = 200  # whose smoothed estimate is the centre of an unknown initial state


@dataclass(frozen=True)
class Prepared:
    """The arguments of the loop over samples, and `notes`: what the user is told of them."""

    task: Task
    notes: tuple[str, ...] = ()


def prepared(case: Case, inside: bool = False) -> Prepared:
    """The recording with a model on states that are good everywhere, its start and its substeps. `inside`: as
    in `local_model`. Raises EstimationError `filter-initial-state`, `filter-noise-correlated`."""
    explicit, theta, options = case.model.explicit, case.model.theta, case.options
    initial = options.initial
    noise = Noise(*case.model.independent_noise())
    experiment = in_model_order(case.measured, explicit.flat)
    time, inputs = experiment.time, experiment.inputs
    v0 = _first_slopes(explicit, time, inputs)
    x0 = _first_state(explicit, theta, inputs[0], v0, float(time[0]))
    mean, known_cov = (x0, None) if initial is None else _given_start(explicit, initial, x0)
    notes = _doubts(explicit)
    has_events = explicit.flat.events is not None
    used = explicit if has_events else good_everywhere(explicit)
    if used is not explicit:
        mean, known_cov = in_states_of(used, explicit, mean, known_cov, theta, time, inputs)
        notes += ("All differentiated variables are states, tied by the constraints of the model.",)
    model = local_model(used, inside=inside, compiled=options.compiled)
    data = record(model, time, inputs, experiment.outputs, options.hold)
    size = _sizes(used, mean, theta, time, inputs, options.hold, options.compiled)
    cov = np.diag(size**2)
    cov = cov if known_cov is None else np.where(np.isinf(known_cov), cov, known_cov)
    start = Start(mean, cov)
    if used.invariants is not None:
        plain = Task.of(model, data, theta, noise, start, np.inf)
        start = Start(*project(plain, mean, cov, data.u0[0], float(time[0]))[:2])
    found = Prepared(Task.of(model, data, theta, noise, start, np.inf), notes)
    if known_cov is None or not np.all(np.isfinite(known_cov)):
        found = _recentred(found, known_cov)
    if has_events:
        return found
    if options.longest is not None:
        return _with_longest(found, options.longest)
    return _with_substeps(found)


def discrete_slots(explicit: Dynamics) -> list[int]:
    """The parameters that hold the Boolean and Integer variables which events assign."""
    events = explicit.flat.events
    return [] if events is None else [one.slot for one in events.assignments if one.slot >= 0]


def discrete_names(explicit: Dynamics) -> tuple[str, ...]:
    """Boolean and Integer variables that events assign."""
    events = explicit.flat.events
    return () if events is None else tuple(one.name for one in events.assignments if one.slot >= 0)


def _with_longest(ready: Prepared, longest: float, *notes: str) -> Prepared:
    return Prepared(replace(ready.task, longest=longest), (*ready.notes, *notes))


def _doubts(explicit: Dynamics) -> tuple[str, ...]:
    """What a filter of a model without equations may pass over."""
    if explicit.flat.events is not None:
        return (MODES_FOLLOWED,)
    if not explicit.may_jump:
        return ()
    return (
        "The FMU may have events: discrete variables fit the estimate at each point, but states that jump, "
        "clocks and delays are not followed.",
    )


def _first_state(
    explicit: Dynamics, theta: np.ndarray, u0: np.ndarray, v0: np.ndarray, time: float
) -> np.ndarray:
    """The start of the model itself."""
    if isinstance(explicit, ExplicitModel) and explicit.flat.events is not None:
        return settled_start(EventFunctions(explicit), theta, np.concatenate([u0, v0]), time)[0]
    return initial_point(explicit, theta, u0, v0, time)[0]


def _first_slopes(explicit: Dynamics, time: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """v at the first sample."""
    sources = [d.index for d in explicit.input_derivatives]
    return (inputs[1, sources] - inputs[0, sources]) / (time[1] - time[0])


def _given_start(explicit: Dynamics, initial: InitialState, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n = explicit.n_states
    if initial.mean.shape != (n,) or initial.cov.shape != (n, n):
        raise EstimationError(
            "filter-initial-state",
            f"the initial state needs a mean of {n} numbers and an {n} x {n} covariance",
            remedy=f"the states are {', '.join(explicit.state_names)}",
        )
    return np.where(initial.is_unknown, x0, initial.mean), initial.cov


def in_states_of(
    redundant: Dynamics,
    explicit: Dynamics,
    mean: np.ndarray,
    cov: np.ndarray | None,
    theta: np.ndarray,
    time: np.ndarray,
    inputs: np.ndarray,
) -> tuple[np.ndarray, np.ndarray | None]:
    """A start of `explicit` in the states of the redundant model. A covariance is carried over by the
    slopes of the internal variables; one with unknown states becomes unknown as a whole. Shapes: mean
    (n_x,), cov (n_x, n_x), theta (n_theta,), time (n_samples,), inputs (n_samples, n_u)."""
    u0, v0 = inputs[0], _first_slopes(explicit, time, inputs)
    arguments = (u0, v0, np.zeros(len(explicit.flat.noises)), theta, float(time[0]))

    def states(x: np.ndarray) -> np.ndarray:
        return matching_states(
            explicit, redundant, x, np.array(explicit.variables(x, *arguments)).ravel(), arguments
        )

    whole = states(mean)
    if cov is None or not np.all(np.isfinite(cov)):
        return whole, None
    names = explicit.flat.unknown_names
    x: ca.MX = ca.MX.sym("x", explicit.n_states)
    slopes = ca.jacobian(
        ca.vertcat(explicit.variables(x, *arguments), explicit.variable_derivatives(x, *arguments)), x
    )
    table = np.array(ca.Function("slopes", [x], [ca.densify(slopes)])(mean))
    rows = [*names, *(f"der({name})" for name in names)]
    along = table[[rows.index(name) for name in redundant.state_names]]
    return whole, along @ cov @ along.T


def _sizes(
    explicit: Dynamics,
    x0: np.ndarray,
    theta: np.ndarray,
    time: np.ndarray,
    inputs: np.ndarray,
    hold: Hold,
    compiled: bool,
) -> np.ndarray:
    """How far each state moves in a simulation of the record, at least its nominal value (1 where none is
    given and it does not move)."""
    nominal = {v.name: v.nominal for v in explicit.flat.unknowns}
    given = np.array([abs(nominal.get(name) or 0.0) for name in explicit.state_names])
    engine = integrator(explicit, compiled=compiled)
    try:
        states = integrate(engine, time, inputs, theta, x0, hold=hold).states
        moved = np.ptp(states, axis=0)
    except IntegrationError:
        moved = np.zeros(x0.size)
    size = np.maximum(given, np.where(np.isfinite(moved), moved, 0.0))
    return np.where(size > 0.0, size, 1.0)


def _recentred(ready: Prepared, known_cov: np.ndarray | None) -> Prepared:
    """An unknown start moves to the smoothed estimate of a first pass over the beginning, FIT.start_width
    times as wide."""
    task, whole = ready.task, ready.task.data
    head = Record(*(part[:START_SAMPLES] for part in (whole.time, whole.u0, whole.u1, whole.outputs)))
    try:
        longest = float(np.median(head.steps)) / 2
        run = run_ekf(task.model, head, task.theta, task.noise, task.start, longest)
        joint = smooth_ekf(run, head, task.noise)
    except (IntegrationError, np.linalg.LinAlgError):
        return ready
    n = task.start.mean.size
    unknown = np.ones(n, bool) if known_cov is None else np.isinf(np.diagonal(known_cov))
    mean, cov = task.start.mean.copy(), task.start.cov.copy()
    mean[unknown] = joint.mean[0, :n][unknown]
    found = joint.cov[0, :n, :n][np.ix_(unknown, unknown)]
    width = np.minimum(
        FIT.start_width, np.sqrt(np.diagonal(cov)[unknown] / np.maximum(np.diagonal(found), TINY))
    )
    cov[np.ix_(unknown, unknown)] = found * np.outer(width, width)
    if not (np.all(np.isfinite(mean)) and np.all(np.isfinite(cov))):
        return ready
    note = (
        "The initial state is unknown: it starts at a first smoothed estimate, with "
        f"{FIT.start_width:g} times its standard deviation."
    )
    return Prepared(replace(task, start=Start(mean, cov)), (*ready.notes, note))


def _with_substeps(ready: Prepared) -> Prepared:
    """Halve the substeps until the extended filter's estimate changes by less than FIT.filter_substeps."""
    task = ready.task
    period = float(np.median(task.data.steps))
    coarse, longest = _try_ekf(task, np.inf), np.inf
    for halvings in range(1, int(np.log2(MOST_SUBSTEPS)) + 1):
        finer = period / 2**halvings
        fine = _try_ekf(task, finer)
        if coarse is not None and fine is not None and _change(coarse, fine) <= FIT.filter_substeps:
            break
        coarse, longest = fine, finer
    else:
        note = (
            f"The estimate still changes at {MOST_SUBSTEPS} steps of linearisation per sample: the model has "
            "a jump or a bend sharper than its state is known. Round it over a width (tanh), or compare with "
            "--kind particle."
        )
        return _with_longest(ready, longest, note)
    if np.isinf(longest):
        return ready
    return _with_longest(ready, longest, f"{round(period / longest)} steps of linearisation per sample.")


def _try_ekf(task: Task, longest: float) -> tuple[np.ndarray, np.ndarray] | None:
    try:
        run = run_ekf(task.model, task.data, task.theta, task.noise, task.start, longest)
    except IntegrationError:
        return None
    return run.filtered, np.sqrt(np.maximum(np.diagonal(run.filtered_cov, axis1=1, axis2=2), 0.0))


def _change(coarse: tuple[np.ndarray, np.ndarray], fine: tuple[np.ndarray, np.ndarray]) -> float:
    """Largest rms change of a state, in its standard deviations; a state without uncertainty counts by its
    rms."""
    std = fine[1]
    floor = 1e-6 * np.sqrt(np.mean(fine[0] ** 2, axis=0))
    size = np.maximum(np.maximum(std, floor), np.finfo(float).tiny)
    return float(np.max(np.sqrt(np.mean(((coarse[0] - fine[0]) / size) ** 2, axis=0)), initial=0.0))
