"""Simulation of an explicit model under recorded inputs, without and with noise at the annotated places."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import singledispatch
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import DaestError, ModelError, NumericalError
from daest.model.experiment import Experiment, Simulation
from daest.model.flat import Dynamics, ExplicitModel, FlatModel, Model, events_refused
from daest.model.holds import SMOOTH, Hold, held_inputs, interval_ends
from daest.model.linear import DiscreteModel, StateSpace
from daest.numerics.evaluator import Evaluator
from daest.numerics.exponential import covariance_integral, transition_integrals
from daest.numerics.projection import pull
from daest.numerics.quiet import native_silence
from daest.numerics.recursions import linear_recursion
from daest.numerics.threads import one_thread
from daest.systems.events.event_functions import EventFunctions
from daest.systems.events.event_update import Mode, settled_start
from daest.systems.events.hybrid import HybridRun, Inputs, follow
from daest.systems.events.integration import IntegrationError
from daest.systems.events.modes import in_starting_mode
from daest.systems.events.switches import extended, with_switches
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.linear.state_space import (
    family_for,
    sample,
    stacked_inputs,
    state_space,
    state_space_family,
)
from daest.systems.reduction.expand import name_equations
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.input_slopes import acting_slopes, moved_variables, no_input_derivative
from daest.systems.reduction.reduce import dynamics
from daest.systems.reduction.redundant import good_everywhere, matching_states
from daest.systems.simulation.integrate import (
    ALL_STEPS,
    EquationIntegrator,
    integrate,
    integrator,
    interval_inputs,
    slopes_at_samples,
)
from daest.systems.tolerances import SOLVER

Recording = Experiment | tuple[np.ndarray, np.ndarray]

JUMPS = ("simulation-failed", "initial-not-solved", "singular-after-reduction")
"""Failures that relations in the equations may cause."""

TOLD = ("events-chatter", "events-do-not-settle")
"""Failures of a simulation with events that say more than that of one without."""

SUBSTEPS = 4  # local linearisations per sample interval when a nonlinear model is simulated with noise


@dataclass(frozen=True)
class _Task:
    """What a simulation needs, checked: v (n_samples, n_v) are the slopes of the inputs at the samples."""

    explicit: Dynamics
    time: np.ndarray
    u: np.ndarray
    v: np.ndarray
    theta: np.ndarray
    x0: np.ndarray
    hold: Hold
    mode: Mode | None = None
    tears: np.ndarray | None = None  # guesses at the samples, as `values_along` takes them

    @property
    def steps(self) -> np.ndarray:
        return np.diff(self.time)


def simulate(
    model: Model | Dynamics,
    recording: Recording,
    *,
    theta: np.ndarray | None = None,
    hold: Hold = "foh",
    x0: np.ndarray | Mapping[str, float] | None = None,
    noise: bool = False,
    seed: int | None = None,
    intensities: Mapping[str, float] | None = None,
    rtol: float = SOLVER.simulation_rtol,
    tell: Callable[[str], object] = lambda _: None,
) -> Simulation:
    """States, outputs and all internal variables at the times of `recording`.

    `recording`: an Experiment whose inputs are used, or (time, inputs (n_samples, n_u)). `theta`: all
    parameters (default: the model's values). `hold`: inputs constant, straight or smooth between samples;
    first derivatives of inputs that the model needs are the slopes of foh or of the smooth curves. `x0`: all
    states, or start values of variables by name, else the consistent initial point of the model.

    States that follow affine laws are computed exactly by matrix exponentials; others by Radau IIA with
    adaptive steps at `rtol`. `noise` adds white noise with its intensity (`intensities` by name win over
    the model's) and measurement noise of the outputs' std: exactly sampled for affine models, else by local
    linearisation on substeps (Itô). Where white noise reaches an output directly it is held over each
    sample, (43)-(45). Where a choice of states would become singular on the way, all differentiated
    variables are states and every step is pulled back onto the constraints.

    `tell` hears of the progress of a long simulation; an exception in it ends the simulation.

    Where relations in the equations are discontinuities that the integration does not pass, it is done once
    more with each of them as an event.

    Raises ModelError `simulation-input`, `parameter-outside-bounds`, `input-derivative-order`,
    `input-derivative-hold`, `noise-intensity-missing` and what `initial_point` raises; NumericalError
    `simulation-failed`.
    """
    try:
        return _simulate(
            model, recording, theta, hold, x0, rtol, tell,
            noise=noise, seed=seed, intensities=intensities or {},
        )  # fmt: skip
    except DaestError as error:
        flat = model if isinstance(model, FlatModel) else getattr(model, "flat", None)
        if not isinstance(flat, FlatModel) or noise or isinstance(x0, np.ndarray) or error.code not in JUMPS:
            raise
        switched = with_switches(flat)
        if switched is None:
            raise
        try:
            return _simulate(switched, recording, extended(theta, switched), hold, x0, rtol, tell)
        except DaestError as second:
            raise (second if second.code in TOLD else error) from None


def _simulate(
    model: Model | Dynamics,
    recording: Recording,
    theta: np.ndarray | None,
    hold: Hold,
    x0: np.ndarray | Mapping[str, float] | None,
    rtol: float,
    tell: Callable[[str], object],
    *,
    noise: bool = False,
    seed: int | None = None,
    intensities: Mapping[str, float] = MappingProxyType({}),
) -> Simulation:
    if isinstance(model, FlatModel) and model.events is not None:
        model = in_starting_mode(model, recording, theta)
    explicit = model if isinstance(model, Dynamics) else dynamics(model)
    task = _prepare(explicit, recording, theta, hold, x0)
    is_affine = explicit.flat.events is None and has_affine_dynamics(explicit)
    rng = np.random.default_rng(seed)
    w = np.zeros((task.time.size, len(explicit.flat.noises)))
    intensity = _intensities(explicit.flat, intensities) if noise else np.zeros(0)
    task = task if is_affine or explicit.flat.events is not None else _good_everywhere(task)
    with one_thread():  # many small matrices: a second thread only waits
        if explicit.flat.events is not None:
            if np.any(intensity > 0):
                raise events_refused("a simulation with noise")
            return _told(task, _followed(task, rtol), rtol)
        if np.any(intensity > 0):
            states, w, method = (_affine_noisy if is_affine else _nonlinear_noisy)(task, intensity, rng)
        elif is_affine:
            states, method = _affine(task)
        else:
            task, states, method = _nonlinear(task, rtol, tell)
    result = _collect(task, states, w, method)
    if not noise:
        return result
    std = [0.0 if output.noise_std is None else output.noise_std for output in explicit.flat.outputs]
    noisy = result.outputs + rng.standard_normal(result.outputs.shape) * np.array(std)
    return replace(result, outputs=noisy, with_noise=True, seed=seed)


def _prepare(
    explicit: Dynamics,
    recording: Recording,
    theta: np.ndarray | None,
    hold: Hold,
    x0: np.ndarray | Mapping[str, float] | None,
) -> _Task:
    time, u = _inputs(explicit.flat, recording)
    values = explicit.flat.checked_theta(theta)
    v = _slopes(explicit, time, u, values, hold)
    if explicit.flat.events is not None and not isinstance(x0, np.ndarray):
        ubar = np.concatenate([u[0], v[0]])
        assert isinstance(explicit, ExplicitModel)
        start, mode = settled_start(EventFunctions(explicit), values, ubar, float(time[0]), x0)
        return _Task(explicit, time, u, v, values, start, hold, mode)
    if isinstance(x0, Mapping) or x0 is None:
        start, _ = initial_point(explicit, values, u[0], v[0], float(time[0]), given=x0)
    else:
        start = np.asarray(x0, dtype=float)
    if start.shape != (explicit.n_states,):
        raise ModelError(
            "simulation-input", f"x0 has shape {start.shape}, the model {explicit.n_states} states"
        )
    return _Task(explicit, time, u, v, values, start, hold)


def _inputs(flat: Model, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """time (n_samples,) and inputs (n_samples, n_u) in the model's order."""
    names = flat.input_names
    if isinstance(recording, Experiment):
        missing = [name for name in names if name not in recording.input_names]
        if missing:
            raise ModelError(
                "simulation-input",
                f"the recording {recording.name} has no input {', '.join(missing)}",
                remedy="map a column to it under [data.inputs]",
            )
        time, u = recording.time, recording.inputs_of(names)
    else:
        time, u = (np.asarray(part, dtype=float) for part in recording)
        u = u.reshape(time.size, -1) if u.ndim == 1 else u
    if u.shape != (time.size, len(names)):
        raise ModelError(
            "simulation-input", f"inputs have shape {u.shape}, expected {(time.size, len(names))}"
        )
    if time.size == 0 or np.any(np.diff(time) <= 0) or not np.all(np.isfinite(u)):
        raise ModelError("simulation-input", "times must increase and inputs must be finite")
    return time, u


def _slopes(explicit: Dynamics, time: np.ndarray, u: np.ndarray, theta: np.ndarray, hold: Hold) -> np.ndarray:
    """Input derivatives v (n_samples, n_v) as `slopes_at_samples` has them; refused where the model moves by
    one that the hold does not have."""
    held = held_inputs(hold, explicit.flat.input_names)
    for derivative in acting_slopes(explicit, theta=theta):
        if derivative.order > 1 or held[derivative.index]:
            raise _differentiated(explicit.flat, derivative.index, derivative.order, hold)
    return slopes_at_samples(explicit, time, u, hold)


def _differentiated(flat: Model, source: int, order: int, hold: Hold) -> ModelError:
    """The refusal of a derivative of an input, with the equations that contain the input."""
    rows: tuple[int, ...] = ()
    if isinstance(flat, FlatModel):
        rows = tuple(sorted(set(ca.jacobian_sparsity(flat.residual, flat.u[source]).get_triplet()[0])))
    place = next((flat.equations[r].place for r in rows), None)
    lines = name_equations(flat.equations, rows)
    return no_input_derivative(flat.inputs[source].name, order, hold, lines, place)


def _intensities(flat: Model, given: Mapping[str, float]) -> np.ndarray:
    values = [given.get(n.name, n.intensity) for n in flat.noises]
    for noise, value in zip(flat.noises, values, strict=True):
        if value is None:
            raise ModelError(
                "noise-intensity-missing",
                f"the white noise {noise.name} has no intensity",
                where=noise.place,
                remedy="write annotation(__Daest(noise = true, intensity = ...)), in [unit]^2 s",
            )
    return np.array(values, dtype=float)


def _step_groups(steps: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Interval lengths and the positions of the intervals that have them."""
    if steps.size == 0:
        return []
    order = np.argsort(steps, kind="stable")
    cuts = np.flatnonzero(np.diff(steps[order]) > SOLVER.equal_steps * steps[order][1:]) + 1
    return [(float(np.mean(steps[part])), part) for part in np.split(order, cuts)]


def _affine(task: _Task) -> tuple[np.ndarray, str]:
    ss = _state_space(task)
    models, inputs = _discrete_models(task, ss, None), _inputs_of(ss, task)
    drives = np.empty((task.steps.size, task.x0.size))
    for model, part in models:
        drives[part] = _drive(model, inputs, part)
    return _run(models, drives, task.x0), f"matrix exponential, {task.hold}"


def _affine_noisy(
    task: _Task, intensity: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, str]:
    """States, mean noise of every interval, method. w̄ and the noise of the states are drawn jointly."""
    ss = _state_space(task)
    models, inputs = _discrete_models(task, ss, intensity), _inputs_of(ss, task)
    n_w, n_x = intensity.size, task.x0.size
    drives, w = np.empty((task.steps.size, n_x)), np.zeros((task.time.size, n_w))
    draws = rng.standard_normal((task.time.size, n_w + n_x))
    for model, part in models:
        cross = model.noise_process_cov
        joint = np.block([[model.noise_cov, cross], [cross.T, model.process_cov]])
        noises = draws[part] @ _square_root(joint).T
        w[part] = noises[:, :n_w]
        drives[part] = _drive(model, inputs, part) + noises[:, n_w:]
    if models:
        last = next(model for model, part in models if task.steps.size - 1 in part)
        w[-1] = draws[-1, :n_w] * np.sqrt(np.diag(last.noise_cov))
    kind = "held over a sample" if _reaches_outputs(ss, intensity) else "sampled exactly"
    return _run(models, drives, task.x0), w, f"matrix exponential, {task.hold}, white noise {kind}"


def _state_space(task: _Task) -> StateSpace:
    return state_space(family_for(state_space_family(task.explicit), task.hold), task.theta)


def _reaches_outputs(ss: StateSpace, intensity: np.ndarray) -> bool:
    return bool(np.any(np.abs(ss.H) @ intensity > 0))


def _discrete_models(
    task: _Task, ss: StateSpace, intensity: np.ndarray | None
) -> list[tuple[DiscreteModel, np.ndarray]]:
    """One sampled model per interval length, with the positions of its intervals."""
    held = intensity is not None and _reaches_outputs(ss, intensity)
    return [
        (sample(ss, step, task.hold, intensity, noise="held" if held else "white"), part)
        for step, part in _step_groups(task.steps)
    ]


def _inputs_of(ss: StateSpace, task: _Task) -> np.ndarray:
    """ū (n_samples, n_ū) of the state space of a task."""
    if task.hold == SMOOTH:
        return stacked_inputs(task.u, task.time, ss.input_derivatives, task.hold)
    return np.hstack([task.u, task.v])


def _drive(model: DiscreteModel, stacked: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Input part of the recursion for the intervals `part`, (n_part, n_states), of ū `stacked`."""
    return stacked[part] @ model.input_now.T + stacked[part + 1] @ model.input_next.T + model.drift


def _run(models: list[tuple[DiscreteModel, np.ndarray]], drives: np.ndarray, x0: np.ndarray) -> np.ndarray:
    if len(models) == 1:
        return linear_recursion(models[0][0].transition, drives, x0)
    states = np.empty((drives.shape[0] + 1, x0.size))
    states[0] = x0
    group = np.empty(drives.shape[0], dtype=int)
    for number, (_, part) in enumerate(models):
        group[part] = number
    for k, number in enumerate(group):
        states[k + 1] = models[number][0].transition @ states[k] + drives[k]
    return states


def _square_root(covariance: np.ndarray) -> np.ndarray:
    """L with L Lᵀ = covariance, which may be singular; scaled to unit variances: units do not matter."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    return safe[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def _good_everywhere(task: _Task) -> _Task:
    """The task on all differentiated variables, with the invariants that tie them, where the choice of states
    could become singular on the way."""
    redundant = good_everywhere(task.explicit)
    if redundant is task.explicit:
        return task
    w = np.zeros(len(task.explicit.flat.noises))
    arguments = (task.u[0], task.v[0], w, task.theta, float(task.time[0]))
    xi = np.array(task.explicit.variables(task.x0, *arguments)).ravel()
    x0 = matching_states(task.explicit, redundant, task.x0, xi, arguments)
    return replace(task, explicit=redundant, x0=x0)


def _nonlinear(task: _Task, rtol: float, tell: Callable[[str], object]) -> tuple[_Task, np.ndarray, str]:
    """The task with the solutions that its loops were at, states and method."""
    begin, end = task.time[0], task.time[-1]

    def told(reached: float) -> None:
        percent = int(100 * (reached - begin) / (end - begin))
        tell(f"simulating: t = {reached:.4g} of {end:.4g} s ({percent} of 100)")

    engine = integrator(task.explicit, runs_once=True)
    scale = _state_scale(task.explicit)
    try:
        run = integrate(
            engine, task.time, task.u, task.theta, task.x0,
            hold=task.hold, rtol=rtol, state_scale=scale, max_steps=ALL_STEPS, tell=told,
        )  # fmt: skip
    except IntegrationError as error:
        raise _failed(task.explicit, error.time, error.reason) from error
    return replace(task, tears=run.tears), run.states, engine.method(rtol, task.hold)


def simulate_modes(
    flat: FlatModel, recording: Recording, *, hold: Hold = "foh"
) -> tuple[ExplicitModel, Simulation, np.ndarray]:
    """The reduced form of a model with events, its simulation, and at every sample all parameters with what
    keeps its value between events (n_samples, n_theta): the mode. Raises what `simulate` raises."""
    explicit = dynamics(in_starting_mode(flat, recording))
    assert isinstance(explicit, ExplicitModel)
    task = _prepare(explicit, recording, None, hold, None)
    rtol = SOLVER.simulation_rtol
    with one_thread():
        run = _followed(task, rtol)
    return explicit, _told(task, run, rtol), run.theta


def _followed(task: _Task, rtol: float) -> HybridRun:
    engine = integrator(task.explicit, runs_once=True)
    assert isinstance(engine, EquationIntegrator)
    u0, u1 = interval_inputs(task.explicit, task.time, task.u, task.hold)
    last = task.u[-1:] if not len(u1) else np.hstack([task.u[-1:], u1[-1:, task.u.shape[1] :]])
    atol = rtol * SOLVER.atol_of_scale * _state_scale(task.explicit)
    try:
        return follow(
            engine, Inputs(task.time, u0, u1, last), task.theta, task.x0, task.mode,
            directions=0, rtol=rtol, atol=atol, max_steps=ALL_STEPS,
        )  # fmt: skip
    except IntegrationError as error:
        raise _failed(task.explicit, error.time, error.reason) from error


def _told(task: _Task, run: HybridRun, rtol: float) -> Simulation:
    count = f"{run.n_events} event{'' if run.n_events == 1 else 's'}"
    method = f"Radau IIA order 5, adaptive steps, rtol {rtol:g}, {count}, {task.hold}"
    w = np.zeros((task.time.size, len(task.explicit.flat.noises)))
    along = replace(task, theta=run.theta.T, tears=run.tears)
    return _with_memory(_collect(along, run.states, w, method), task, run)


def _with_memory(result: Simulation, task: _Task, run: HybridRun) -> Simulation:
    """The simulation with the Boolean and Integer variables that events assign among its variables."""
    events = task.explicit.flat.events
    assert events is not None
    kept = [one for one in events.assignments if one.slot >= 0]
    return replace(
        result,
        variables=np.hstack([result.variables, run.theta[:, [one.slot for one in kept]]]),
        variable_names=(*result.variable_names, *(one.name for one in kept)),
        units={**result.units, **{one.name: "" for one in kept}},
    )


def _failed(explicit: Dynamics, time: float, reason: str) -> NumericalError:
    return NumericalError(
        "simulation-failed",
        f"the simulation stopped at t = {time:g} s: {reason}",
        remedy=f"check the parameters and the inputs at that time{explicit.check_if_stopped}",
    )


def _nonlinear_noisy(
    task: _Task, intensity: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, str]:
    """States, mean noise of every interval, method; noise that reaches an output is held over each sample."""
    slopes, hold = _slope_function(task.explicit), _hold_function(task.explicit)
    arguments = task.explicit.outputs.mx_in()
    held = bool(ca.jacobian_sparsity(task.explicit.outputs(*arguments), arguments[3]).nnz())
    states = np.empty((task.time.size, task.x0.size))
    states[0] = task.x0
    lengths = np.append(task.steps, task.steps[-1:] if task.steps.size else 1.0)
    w = rng.standard_normal((task.time.size, intensity.size)) * np.sqrt(intensity / lengths[:, None])
    rises = interval_ends(task.u, task.hold, task.explicit.flat.input_names) - task.u[:-1]
    for k in range(task.steps.size):
        states[k + 1], mean = _noisy_interval(
            slopes, hold, task, k, rises[k], states[k], w[k] if held else None, intensity, rng
        )
        w[k] = w[k] if held else mean
        if not np.all(np.isfinite(states[k + 1])):
            raise _failed(task.explicit, float(task.time[k]), "the model gives no finite derivative")
    kind = "held over a sample" if held else "white"
    pulled = "" if hold is None else ", projected on the constraints"
    passed = ", states that jump are not followed" if task.explicit.may_jump else ""
    return states, w, f"local linearisation, {SUBSTEPS} substeps, {task.hold}, noise {kind}{pulled}{passed}"


def _noisy_interval(
    slopes: Evaluator,
    hold: Evaluator | None,
    task: _Task,
    k: int,
    rise: np.ndarray,
    x: np.ndarray,
    held: np.ndarray | None,
    intensity: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """State at the end of interval k, in which the inputs rise by `rise` (n_u,), and the mean of w over it,
    from x at its start.

    Local linearisation (Jimenez & Ozaki): per substep the exact solution, mean and covariance, of the model
    linearised at the substep's start in x and at its middle in u and t; order 2 in the drift."""
    step = float(task.steps[k])
    between = (
        task.v[k] if task.hold == SMOOTH else rise[[d.index for d in task.explicit.input_derivatives]] / step
    )
    w = np.zeros(intensity.size) if held is None else held
    total = np.zeros(intensity.size)
    for number in range(SUBSTEPS):
        middle = (number + 0.5) / SUBSTEPS
        at = (task.u[k] + middle * rise, between, w, task.theta, task.time[k] + middle * step)
        white = intensity if held is None else None
        x, increment = _local_step(task.explicit, slopes, x, at, step / SUBSTEPS, white, rng)
        total += increment
        end = (number + 1.0) / SUBSTEPS
        then = (task.u[k] + end * rise, between, w, task.theta, task.time[k] + end * step)
        x = _on_constraints(hold, task.explicit, x, then)
    return x, total / step


def _slope_function(explicit: Dynamics) -> Evaluator:
    """(x, u, v, w, theta, t) -> f, ∂f/∂x, ∂f/∂w."""
    arguments: Any = explicit.rhs.sx_in() if explicit.is_symbolic else explicit.rhs.mx_in()
    f: Any = explicit.rhs(*arguments)
    parts = [f, ca.jacobian(f, arguments[0]), ca.jacobian(f, arguments[3])]
    return Evaluator(ca.Function("slopes", arguments, [ca.densify(part) for part in parts]))


def _hold_function(explicit: Dynamics) -> Evaluator | None:
    """(x, u, v, w, theta, t) -> g, ∂g/∂x; None where the states are free."""
    if explicit.invariants is None:
        return None
    arguments = explicit.invariants.sx_in()
    g = explicit.invariants(*arguments)
    slopes = ca.jacobian(g, arguments[0])
    return Evaluator(ca.Function("hold", arguments, [ca.densify(g), ca.densify(slopes)]))


def _on_constraints(hold: Evaluator | None, explicit: Dynamics, x: np.ndarray, at: tuple) -> np.ndarray:
    """The state with (u, v, w, theta, t) = `at` on the constraints that tie its components."""
    if hold is None or not np.all(np.isfinite(x)):
        return x

    def invariants(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        g, R = hold(state, *at)
        return g.ravel(), R

    try:
        return pull(invariants, x, _state_scale(explicit), SOLVER.projected_to_rounding).x
    except np.linalg.LinAlgError as error:
        raise _failed(explicit, float(at[-1]), "the constraints of the model depend on each other") from error


def _state_scale(explicit: Dynamics) -> np.ndarray:
    """Nominal sizes (n_states,), 1 where none is given."""
    nominal = {v.name: v.nominal for v in explicit.flat.unknowns}
    return np.array([abs(nominal.get(name) or 1.0) for name in explicit.state_names])


def _local_step(
    explicit: Dynamics,
    slopes: Evaluator,
    x: np.ndarray,
    at: tuple,
    h: float,
    intensity: np.ndarray | None,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """The state after h and the integral of w over h (zero when `intensity` is None)."""
    try:
        f, A, G = slopes(x, *at)
    except RuntimeError as error:
        raise _failed(
            explicit, float(at[-1]), "a nonlinear equation inside the model has no solution"
        ) from error
    if not (np.all(np.isfinite(f)) and np.all(np.isfinite(A))):
        return np.full(x.size, np.nan), np.zeros(G.shape[1])
    first = transition_integrals(A, h).first
    moved = x + first @ f[:, 0]
    if intensity is None:
        return moved, np.zeros(G.shape[1])
    spread = G * intensity
    cross = (first @ spread).T  # E ∫w x̃ᵀ
    joint = np.block([[np.diag(intensity * h), cross], [cross.T, covariance_integral(A, spread @ G.T, h)]])
    draw = _square_root(joint) @ rng.standard_normal(joint.shape[0])
    return moved + draw[intensity.size :], draw[: intensity.size]


@singledispatch
def values_along(
    explicit: Dynamics,
    time: np.ndarray,
    ubar: np.ndarray,
    theta: np.ndarray,
    states: np.ndarray,
    hold: Hold,
    w: np.ndarray | None = None,
    tears: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (n_samples, n_y) and internal variables (n_samples, n) along states (n_samples, n_states),
    inputs with their slopes ū (n_samples, n_ū) and noises w (n_samples, n_w), zero for None. `tears`
    (n_samples, n_tears): guesses of loops with several solutions (`Trajectory.tears`)."""
    raise NotImplementedError(type(explicit).__name__)


@values_along.register
def _of_equations(
    explicit: ExplicitModel,
    time: np.ndarray,
    ubar: np.ndarray,
    theta: np.ndarray,
    states: np.ndarray,
    hold: Hold,
    w: np.ndarray | None = None,
    tears: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    n_u = len(explicit.flat.inputs)
    w = np.zeros((time.size, len(explicit.flat.noises))) if w is None else w
    columns = (states.T, ubar[:, :n_u].T, ubar[:, n_u:].T, w.T, theta, time[None, :])
    try:
        # Adding zero turns the -0.0 of negated aliases into 0.0.
        with native_silence() if explicit.near else nullcontext():
            outputs, variables = (f(*columns).full().T + 0.0 for f in _along_guesses(explicit, tears))
    except RuntimeError as error:
        if explicit.near is None or explicit.near_variables is None:
            raise _failed(explicit, float(time[-1]), UNSOLVED) from error
        functions = (explicit.near[1], explicit.near_variables)
        with native_silence():
            outputs, variables = (_from_sample_to_sample(explicit, f, time, columns) for f in functions)
    return outputs, variables


def _along_guesses(
    explicit: ExplicitModel, tears: np.ndarray | None
) -> tuple[Callable[..., ca.DM], Callable[..., ca.DM]]:
    """Outputs and variables as functions of columns, one for each sample."""
    if tears is None or explicit.near is None or explicit.near_variables is None:
        return explicit.outputs, explicit.variables
    of_outputs, of_variables = explicit.near[1], explicit.near_variables
    return lambda *at: of_outputs(*at, tears.T)[0], lambda *at: of_variables(*at, tears.T)[0]


MOST_HALVINGS = 6  # of the way between two samples on which the iterations of a loop are led to a solution
UNSOLVED = "an internal variable has no solution"


def _from_sample_to_sample(
    explicit: ExplicitModel, near: ca.Function, time: np.ndarray, columns: tuple
) -> np.ndarray:
    """Values (n_samples, rows) of one of the functions `near`, each iteration begun at the solution of the
    sample before."""
    parts = [np.asarray(c) for c in columns]
    table = [np.broadcast_to(c.T if c.ndim == 2 else c, (time.size, c.shape[0])) for c in parts]
    cuts = np.cumsum([part.shape[1] for part in table])[:-1]
    rows = np.hstack(table)

    def solved(row: np.ndarray, tears: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, found = near(*np.split(row, cuts), tears)
        return value.full().ravel() + 0.0, found.full().ravel()

    def reached(old: np.ndarray, new: np.ndarray, tears: np.ndarray, halvings: int) -> tuple:
        """On the straight way from one row to the other, by smaller steps where the iteration fails."""
        try:
            return solved(new, tears)
        except RuntimeError:
            if halvings == 0:
                raise
        middle = 0.5 * (old + new)
        _, tears = reached(old, middle, tears, halvings - 1)
        return reached(middle, new, tears, halvings - 1)

    values, tears = np.empty((time.size, near.numel_out(0))), np.full(near.numel_in(6), np.nan)
    for k in range(time.size):
        try:
            values[k], tears = reached(rows[max(k - 1, 0)], rows[k], tears, MOST_HALVINGS if k else 0)
        except RuntimeError as error:
            raise _failed(explicit, float(time[k]), UNSOLVED) from error
    return values


def _collect(task: _Task, states: np.ndarray, w: np.ndarray, method: str) -> Simulation:
    explicit, flat = task.explicit, task.explicit.flat
    ubar = np.hstack([task.u, task.v])
    outputs, variables = values_along(explicit, task.time, ubar, task.theta, states, task.hold, w, task.tears)
    variables = variables.reshape(task.time.size, -1)
    if explicit.input_derivatives:
        held = held_inputs(task.hold, flat.input_names)
        variables[:, moved_variables(explicit, held, task.theta)] = np.nan  # the slope of a step is none
    signals: list[Any] = [*flat.inputs, *flat.unknowns, *flat.noises, *flat.outputs]
    units = {signal.name: signal.unit for signal in signals}
    return Simulation(
        model_name=flat.name,
        time=task.time,
        inputs=task.u,
        states=states,
        outputs=outputs.reshape(task.time.size, -1),
        variables=variables,
        noises=w,
        input_names=flat.input_names,
        state_names=explicit.state_names,
        output_names=flat.output_names,
        variable_names=flat.unknown_names,
        noise_names=flat.noise_names,
        units={**units, **dict(zip(explicit.state_names, explicit.state_units, strict=True))},
        hold=task.hold,
        method=method,
    )
