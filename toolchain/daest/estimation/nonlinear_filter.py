"""Filter a recording with a nonlinear model: every internal variable with its standard deviation.

Extended, unscented or particle filter of the index-reduced model, and their smoothers. Where a choice of
states would become singular on the way, all differentiated variables are states and every estimate is
projected onto the constraints. The step of the local linearisation is halved until the estimate no longer
changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

from daest.errors import EstimationError
from daest.estimation.ekf import run_ekf
from daest.estimation.filter import COVERAGE, comparison, used_outputs
from daest.estimation.filter_task import Noise, Record, Start, Task, record
from daest.estimation.interpreted import project
from daest.estimation.nonlinear_smoother import Joint, filtered_joint, smooth_ekf, smooth_ukf
from daest.estimation.particle import ContinuousPoints, ParticleRun, Proposal, run_particles, smooth_particles
from daest.estimation.ukf import UkfRun, run_ukf
from daest.model.defaults import PARTICLES
from daest.model.estimates import FilterResult, InitialState, NisSummary, NonlinearKind, ProcessNoiseEstimate
from daest.model.experiment import Experiment
from daest.model.flat import ExplicitModel
from daest.numerics.distributions import chi2
from daest.systems.initialize import initial_point
from daest.systems.integrate import Hold, IntegrationError, integrate, integrator
from daest.systems.local_linear import LocalModel, internal_function, internal_names, local_model
from daest.systems.redundant import good_everywhere, matching_states

SUBSTEP_TOLERANCE = (
    0.02  # change of the estimate, rms in its standard deviations, that a halved step may make
)
MOST_SUBSTEPS = 64  # per median sample interval
START_WIDTH = 10.0  # standard deviations
TINY = np.finfo(float).tiny
START_SAMPLES = 200  # whose smoothed estimate is the centre of an unknown initial state
CHUNK = 1000  # samples whose internal variables are evaluated at once


@dataclass(frozen=True)
class _Task:
    """The model with its record, and what is known before: `notes` for the user."""

    model: LocalModel
    data: Record
    theta: np.ndarray
    noise: Noise
    start: Start
    longest: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Estimates:
    """values, std (n_samples, n_v); innovations; normalised squares and log-likelihood; mean and std of the
    process noise (n_samples, n_w)."""

    values: np.ndarray
    std: np.ndarray
    innovations: np.ndarray
    nis: np.ndarray
    log_likelihood: float
    noise_mean: np.ndarray
    noise_std: np.ndarray
    effective: np.ndarray | None = None
    notes: tuple[str, ...] = ()


def run_nonlinear_filter(
    explicit: ExplicitModel,
    theta: np.ndarray | None,
    experiment: Experiment,
    process_intensity: np.ndarray,
    measurement_std: np.ndarray,
    kind: NonlinearKind = "ekf",
    measure: Sequence[str] | None = None,
    smooth: bool = False,
    initial: InitialState | None = None,
    hold: Hold = "foh",
    n_particles: int = PARTICLES,
    seed: int | None = None,
    proposal: Proposal = "ekf",
    longest: float | None = None,
    compiled: bool = True,
) -> FilterResult:
    """Estimate all internal variables of `explicit` at `theta` (None: the model's values) from a recording.

    process_intensity (n_w,), measurement_std (n_y,), in the order of the model. `measure` names the outputs
    to use (None: all recorded); the others are compared with their estimates. `initial` is in the states of
    `explicit`; None, or an infinite variance, is unknown: it starts wide around a first smoothed estimate.
    `longest`: of the substeps in seconds (None: found by halving).

    Raises EstimationError `filter-unknown-output`, `filter-initial-state`, `filter-singular-innovation`,
    `output-white-noise`, `particle-collapse`; IntegrationError where the model has no finite value on the
    way.
    """
    flat = explicit.flat
    names = tuple(o.name for o in flat.outputs)
    measure = used_outputs(names, experiment, measure)
    values = flat.theta_values if theta is None else np.asarray(theta, dtype=float)
    noise = Noise(np.asarray(process_intensity, float), np.asarray(measurement_std, float) ** 2)
    inputs = experiment.inputs[:, [experiment.input_names.index(v.name) for v in flat.inputs]]
    outputs = _outputs(experiment, names, measure)
    task = _prepared(explicit, experiment.time, inputs, outputs, values, noise, initial, hold, kind, compiled)
    task = replace(task, longest=longest) if longest is not None else _with_substeps(task)
    found = (
        _particles(task, n_particles, seed, proposal, smooth)
        if kind == "particle"
        else _gaussian(task, kind, smooth)
    )
    return _result(task, found, experiment, kind, smooth, measure, hold)


def _outputs(experiment: Experiment, names: tuple[str, ...], measure: Sequence[str]) -> np.ndarray:
    """(n_samples, n_y) in the order of the model, NaN where not measured or not used."""
    table = np.full((experiment.time.size, len(names)), np.nan)
    for name in measure:
        table[:, names.index(name)] = experiment.outputs[:, experiment.output_names.index(name)]
    return table


def _prepared(
    explicit: ExplicitModel,
    time: np.ndarray,
    inputs: np.ndarray,
    outputs: np.ndarray,
    theta: np.ndarray,
    noise: Noise,
    initial: InitialState | None,
    hold: Hold,
    kind: NonlinearKind,
    compiled: bool,
) -> _Task:
    """The model on states that are good everywhere, and its start."""
    v0 = _first_slopes(explicit, time, inputs)
    x0, _ = initial_point(explicit, theta, inputs[0], v0, float(time[0]))
    mean, known_cov = (x0, None) if initial is None else _given_start(explicit, initial, x0)
    notes = _doubts(explicit)
    used = good_everywhere(explicit)
    if used is not explicit:
        mean, known_cov = _in_states_of(used, explicit, mean, known_cov, theta, time, inputs)
        notes += ("All differentiated variables are states, tied by the constraints of the model.",)
    model = local_model(used, inside=kind == "particle", compiled=compiled)
    data = record(model, time, inputs, outputs, hold)
    size = _sizes(used, mean, theta, time, inputs, hold, compiled)
    cov = (
        np.diag(size**2) if known_cov is None else np.where(np.isinf(known_cov), np.diag(size**2), known_cov)
    )
    start = Start(mean, cov)
    if used.invariants is not None:
        plain = Task.of(model, data, theta, noise, start, np.inf)
        start = Start(*project(plain, mean, cov, data.u0[0], float(time[0]))[:2])
    task = _Task(model, data, theta, noise, start, np.inf, notes)
    return task if known_cov is not None and np.all(np.isfinite(known_cov)) else _recentred(task, known_cov)


def _doubts(explicit: ExplicitModel) -> tuple[str, ...]:
    """What a filter of a model without equations may pass over."""
    given = explicit.flat.given
    if given is None or not given.may_jump:
        return ()
    return (
        "The FMU may have events: discrete variables fit the estimate at each point, but states that jump, "
        "clocks and delays are not followed.",
    )


def _first_slopes(explicit: ExplicitModel, time: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """v at the first sample."""
    sources = [d.index for d in explicit.input_derivatives]
    return (inputs[1, sources] - inputs[0, sources]) / (time[1] - time[0])


def _given_start(
    explicit: ExplicitModel, initial: InitialState, x0: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    n = explicit.n_states
    if initial.mean.shape != (n,) or initial.cov.shape != (n, n):
        raise EstimationError(
            "filter-initial-state",
            f"the initial state needs a mean of {n} numbers and an {n} x {n} covariance",
            remedy=f"the states are {', '.join(explicit.state_names)}",
        )
    return np.where(initial.is_unknown, x0, initial.mean), initial.cov


def _in_states_of(
    redundant: ExplicitModel,
    explicit: ExplicitModel,
    mean: np.ndarray,
    cov: np.ndarray | None,
    theta: np.ndarray,
    time: np.ndarray,
    inputs: np.ndarray,
) -> tuple[np.ndarray, np.ndarray | None]:
    """A start of `explicit` in the states of the redundant model. A covariance is carried over by the slopes
    of the internal variables; one with unknown states becomes unknown as a whole."""
    u0, v0 = inputs[0], _first_slopes(explicit, time, inputs)
    arguments = (u0, v0, np.zeros(len(explicit.flat.noises)), theta, float(time[0]))

    def states(x: np.ndarray) -> np.ndarray:
        return matching_states(
            explicit, redundant, x, np.array(explicit.variables(x, *arguments)).ravel(), arguments
        )

    whole = states(mean)
    if cov is None or not np.all(np.isfinite(cov)):
        return whole, None
    names = [v.name for v in explicit.flat.unknowns]
    x: ca.MX = ca.MX.sym("x", explicit.n_states)
    slopes = ca.jacobian(
        ca.vertcat(explicit.variables(x, *arguments), explicit.variable_derivatives(x, *arguments)), x
    )
    table = np.array(ca.Function("slopes", [x], [ca.densify(slopes)])(mean))
    rows = [*names, *(f"der({name})" for name in names)]
    along = table[[rows.index(name) for name in redundant.state_names]]
    return whole, along @ cov @ along.T


def _sizes(
    explicit: ExplicitModel,
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


def _recentred(task: _Task, known_cov: np.ndarray | None) -> _Task:
    """An unknown start moves to the smoothed estimate of a first pass over the beginning, START_WIDTH times
    as wide: wide enough to carry 1 % of the information, narrow enough for linearisation and sigma points."""
    head = Record(
        *(part[:START_SAMPLES] for part in (task.data.time, task.data.u0, task.data.u1, task.data.outputs))
    )
    try:
        run = run_ekf(task.model, head, task.theta, task.noise, task.start, float(np.median(head.steps)) / 2)
        joint = smooth_ekf(run, head, task.noise)
    except (IntegrationError, np.linalg.LinAlgError):
        return task
    n = task.start.mean.size
    unknown = np.ones(n, bool) if known_cov is None else np.isinf(np.diagonal(known_cov))
    mean, cov = task.start.mean.copy(), task.start.cov.copy()
    mean[unknown] = joint.mean[0, :n][unknown]
    found = joint.cov[0, :n, :n][np.ix_(unknown, unknown)]
    width = np.minimum(START_WIDTH, np.sqrt(np.diagonal(cov)[unknown] / np.maximum(np.diagonal(found), TINY)))
    cov[np.ix_(unknown, unknown)] = found * np.outer(width, width)
    if not (np.all(np.isfinite(mean)) and np.all(np.isfinite(cov))):
        return task
    note = (
        "The initial state is unknown: it starts at a first smoothed estimate, with "
        f"{START_WIDTH:g} times its standard deviation."
    )
    return replace(task, start=Start(mean, cov), notes=(*task.notes, note))


def _with_substeps(task: _Task) -> _Task:
    """Halve the substeps until the extended filter's estimate changes by less than SUBSTEP_TOLERANCE."""
    period = float(np.median(task.data.steps))
    coarse, longest = _try_ekf(task, np.inf), np.inf
    for halvings in range(1, int(np.log2(MOST_SUBSTEPS)) + 1):
        finer = period / 2**halvings
        fine = _try_ekf(task, finer)
        if coarse is not None and fine is not None and _change(coarse, fine) <= SUBSTEP_TOLERANCE:
            break
        coarse, longest = fine, finer
    else:
        note = (
            f"The estimate still changes at {MOST_SUBSTEPS} steps of linearisation per sample: the model has "
            "a jump or a bend sharper than its state is known. Round it over a width (tanh), or compare with "
            "--kind particle."
        )
        return replace(task, longest=longest, notes=(*task.notes, note))
    if np.isinf(longest):
        return task
    note = f"{round(period / longest)} steps of linearisation per sample."
    return replace(task, longest=longest, notes=(*task.notes, note))


def _try_ekf(task: _Task, longest: float) -> tuple[np.ndarray, np.ndarray] | None:
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


def _gaussian(task: _Task, kind: NonlinearKind, smooth: bool) -> _Estimates:
    arguments = (task.model, task.data, task.theta, task.noise, task.start, task.longest)
    data, noise = task.data, task.noise
    if kind == "ekf":
        run = run_ekf(*arguments)
        white = run.innovations / np.sqrt(run.variances)
        nis, innovations, log_likelihood = np.nansum(white**2, axis=1), run.innovations, run.log_likelihood
        joint = (
            smooth_ekf(run, data, noise)
            if smooth
            else filtered_joint(data, noise, run.filtered, run.filtered_cov)
        )
    else:
        other = run_ukf(*arguments)
        nis, innovations, log_likelihood = other.nis, other.innovations, other.log_likelihood
        joint = _unscented_joint(other, data, noise, smooth)
    joint = joint if task.model.hold is None or not smooth else _held(task, joint)
    values, std = _inside(task, joint)
    n = task.model.n_states
    own = np.diagonal(joint.cov, axis1=1, axis2=2)[:, n:]
    return _Estimates(
        values, std, innovations, nis, log_likelihood, joint.mean[:, n:], np.sqrt(np.maximum(own, 0.0))
    )


def _held(task: _Task, joint: Joint) -> Joint:
    """Smoothed estimates on the constraints again: the smoother moves them along straight lines."""
    n = task.model.n_states
    mean, cov = joint.mean.copy(), joint.cov.copy()
    arguments = Task.of(task.model, task.data, task.theta, task.noise, task.start, task.longest)
    for k, time in enumerate(task.data.time):
        mean[k, :n], _, along = project(arguments, mean[k, :n], cov[k, :n, :n], task.data.u0[k], float(time))
        whole = block_diag(along, np.eye(mean.shape[1] - n))
        cov[k] = whole @ cov[k] @ whole.T
    return Joint(mean, cov)


def _unscented_joint(run: UkfRun, data: Record, noise: Noise, smooth: bool) -> Joint:
    return (
        smooth_ukf(run, data, noise)
        if smooth
        else filtered_joint(data, noise, run.filtered, run.filtered_cov)
    )


def _inside(task: _Task, joint: Joint) -> tuple[np.ndarray, np.ndarray]:
    """Internal variables and their standard deviations (n_samples, n_v), by their slopes at the estimate."""
    explicit, n = task.model.explicit, task.model.n_states
    kind: Any = ca.SX if explicit.is_symbolic else ca.MX
    arguments = [kind.sym(f"a{i}", explicit.rhs.numel_in(i)) for i in range(6)]
    value = internal_function(explicit)(*arguments)
    slopes = ca.densify(ca.jacobian(value, ca.vertcat(arguments[0], arguments[3])))
    function = ca.Function("inside", arguments, [value, slopes])
    samples, n_v, n_u = task.data.time.size, value.numel(), len(explicit.flat.inputs)
    values, std = np.empty((samples, n_v)), np.empty((samples, n_v))
    for first in range(0, samples, CHUNK):
        rows = slice(first, min(first + CHUNK, samples))
        count = rows.stop - rows.start
        ubar, mean = task.data.u0[rows], joint.mean[rows]
        columns = [mean[:, :n].T, ubar[:, :n_u].T, ubar[:, n_u:].T, mean[:, n:].T]
        found = function.map(count)(
            *columns, ca.repmat(ca.DM(task.theta), 1, count), task.data.time[rows][None]
        )
        values[rows] = np.array(found[0]).T
        if explicit.flat.given is not None:
            explicit.flat.given.raise_failure()
        J = np.array(found[1]).reshape(n_v, count, -1).transpose(1, 0, 2)
        std[rows] = np.sqrt(
            np.maximum(np.einsum("kvi,kij,kvj->kv", J, joint.cov[rows], J, optimize=True), 0.0)
        )
    return values, std


def _particles(
    task: _Task, n_particles: int, seed: int | None, proposal: Proposal, smooth: bool
) -> _Estimates:
    points = ContinuousPoints(
        Task.of(task.model, task.data, task.theta, task.noise, task.start, task.longest)
    )
    run = run_particles(
        points,
        task.data.outputs,
        task.noise.variance,
        task.start,
        n_particles,
        seed,
        proposal,
        task.data.time,
    )
    notes = _particle_notes(run, task.data.time)
    states, weights = run.points, run.weights
    if smooth:
        found = smooth_particles(points, run, seed)
        states = found.states
        weights = np.full(states.shape[:2], 1.0 / states.shape[1])
        if not found.is_simulated:
            notes += (
                "Process noise does not reach every state: smoothed by the ancestral lines of the particles.",
            )
    inside = [points.inside(k, states[k], weights[k]) for k in range(task.data.time.size)]
    values, std = (np.array(part) for part in zip(*inside, strict=True))
    steps = np.append(task.data.steps, task.data.steps[-1])
    noise_std = np.sqrt(task.noise.intensity / steps[:, None])
    return _Estimates(
        values, std, run.innovations, run.nis, run.log_likelihood,
        np.full_like(noise_std, np.nan) if smooth else np.zeros_like(noise_std),
        np.full_like(noise_std, np.nan) if smooth else noise_std, run.effective, notes,
    )  # fmt: skip


def _particle_notes(run: ParticleRun, time: np.ndarray) -> tuple[str, ...]:
    size = run.weights.shape[1]
    least, median = run.effective.min(), np.median(run.effective)
    notes = [f"Effective sample size: median {median:.0f} of {size}, least {least:.0f}."]
    if run.collapsed.size:
        notes.append(
            f"The particles collapse at {run.collapsed.size} samples, first at t = "
            f"{time[run.collapsed[0]]:g} s: estimates there rest on a few of them. Use more particles or "
            "larger noise."
        )
    return tuple(notes)


def _result(
    task: _Task,
    found: _Estimates,
    experiment: Experiment,
    kind: NonlinearKind,
    smooth: bool,
    measure: tuple[str, ...],
    hold: Hold,
) -> FilterResult:
    flat = task.model.explicit.flat
    names = internal_names(task.model.explicit)
    units = {o.name: o.unit for o in flat.outputs} | {v.name: v.unit for v in flat.unknowns}
    output_names = [o.name for o in flat.outputs]
    rest = [n for n in experiment.output_names if n in output_names and n not in measure]
    columns = {n: (found.values[:, names.index(n)], found.std[:, names.index(n)]) for n in rest}
    measured = {n: experiment.outputs[:, experiment.output_names.index(n)] for n in rest}
    noises = flat.noises
    return FilterResult(
        kind=kind,
        smoothed=smooth,
        names=names,
        units=tuple(units[name] for name in names),
        time=experiment.time,
        values=found.values,
        std=found.std,
        output_names=measure,
        innovations=found.innovations[:, [output_names.index(n) for n in measure]],
        nis=_nis(found.nis, int(np.isfinite(task.data.outputs).sum())),
        log_likelihood=found.log_likelihood,
        measure=measure,
        compared={n: comparison(measured[n], *columns[n]) for n in rest},
        process_noise=ProcessNoiseEstimate(
            tuple(w.name for w in noises), tuple(w.unit for w in noises), found.noise_mean, found.noise_std
        ),
        steady_after=None,
        noise="white",
        hold=hold,
        messages=(*task.notes, *found.notes),
        effective_sample_size=found.effective,
    )


def _nis(nis: np.ndarray, count: int) -> NisSummary:
    if not count:
        return NisSummary(np.nan, np.nan, np.nan, 0)
    tail = (1.0 - COVERAGE) / 2.0
    low, high = chi2.ppf([tail, 1.0 - tail], count) / count
    return NisSummary(float(np.sum(nis)) / count, float(low), float(high), count)
