"""A nonlinear model on recordings: simulation, and one-step prediction by the observer of identification.

Parameters are held; initial states are those that fit best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.diagnosis.comparison.event_trial import with_predictions
from daest.diagnosis.comparison.trial import (
    Candidate,
    Trial,
    growth_of,
    horizons,
    inputs_and_slopes,
    variables_along,
)
from daest.estimation.fitting.coordinates import Unknowns, objective
from daest.estimation.fitting.search import minimise
from daest.estimation.nonlinear.nonlinear_start import at_rest, begun_best, limits
from daest.estimation.nonlinear.observer import Observer, average_model, observer
from daest.estimation.nonlinear.trajectories import Errors, TrajectoryProblem, prediction_errors
from daest.model.comparison import Horizon
from daest.model.experiment import Experiment
from daest.model.flat import Dynamics, ExplicitModel
from daest.model.holds import ZOH
from daest.systems.events.event_functions import EventFunctions
from daest.systems.events.event_update import settled_start
from daest.systems.events.integration import IntegrationError, Trajectory
from daest.systems.reduction.initialize import initial_point
from daest.systems.simulation.integrate import Integrator, integrate, integrator

ITERATIONS = 15  # of the search for initial states
UNKNOWN_NOISE = "no one-step prediction: the noise levels are unknown or give no observer (daest identify)"
STARTS_AHEAD = 200  # samples of a recording from which longer predictions start


@dataclass(frozen=True)
class NonlinearModel:
    """A model ready to be integrated, without and with sensitivities to the estimated parameters."""

    plain: Integrator
    sensitive: Integrator


def nonlinear_model(explicit: Dynamics, names: Sequence[str]) -> NonlinearModel:
    """`names` are the estimated parameters."""
    plain = integrator(explicit)
    return NonlinearModel(plain, integrator(explicit, names) if names else plain)


def nonlinear_trial(candidate: Candidate, experiments: Sequence[Experiment], model: NonlinearModel) -> Trial:
    """Every recording simulated, and predicted with the stationary gain of the average linearisation.

    Without process noise the prediction is the simulation, with events it is that of the extended filter.
    Arrays are NaN where the model cannot be integrated, and there are no residuals where the noise levels are
    unknown or give no observer.
    """
    explicit, flat = model.plain.explicit, candidate.flat
    problem, z = _begun(_problem(candidate, experiments, model))
    simulated = prediction_errors(problem, z)
    known = np.array([output.noise_std is not None for output in flat.outputs], dtype=bool)
    free = _with_past(problem, z)
    predicted = simulated if free is z else prediction_errors(problem, free)
    z, std, cov = free, np.zeros(0), np.zeros(0)
    notes: tuple[str, ...] = ()
    is_output_error = not any(noise.intensity for noise in flat.noises)
    if predicted is not None and is_output_error:
        cov = predicted.covariance
    elif simulated is not None and explicit.flat.events is not None:
        predicted = None
        if not np.all(known):
            notes = (UNKNOWN_NOISE,)
    elif simulated is not None:
        found = _observer(candidate, problem, simulated) if np.all(known) else None
        if found is None:
            notes = (UNKNOWN_NOISE,)
            predicted = None
        else:
            problem = replace(problem, gain=found.gain)
            z = _searched(problem, z)
            predicted, cov = prediction_errors(problem, z), found.innovation_cov
    else:
        notes = ("the model cannot be integrated over the recordings with these values",)
    if predicted is not None:
        std = np.sqrt(np.diagonal(cov))
    trial = Trial(
        simulated=_outputs(experiments, simulated),
        predicted=_outputs(experiments, predicted),
        residuals=() if predicted is None else tuple(e / std for e in predicted.errors),
        variable_names=flat.unknown_names,
        variable_units=tuple(v.unit for v in flat.unknowns),
        simulated_variables=_variables(problem, simulated),
        predicted_variables=_variables(problem, predicted),
        slopes=() if predicted is None else _slopes(candidate, problem, model, z, std),
        initial_states=() if predicted is None else tuple(problem.initial_states(z)),
        growth=() if predicted is None or is_output_error else _growth(candidate, problem, predicted),
        log_likelihood=np.nan if predicted is None else _log_likelihood(predicted, cov),
        is_output_error=is_output_error,
        known_noise=known,
        acts_at_once=candidate.hold != ZOH or explicit.outputs.jac_sparsity(0, 1).nnz() > 0,
        notes=notes,
    )
    is_filtered = explicit.flat.events is not None and simulated is not None and predicted is None
    is_filtered = is_filtered and bool(np.all(known))
    return with_predictions(trial, candidate, experiments, explicit) if is_filtered else trial


def nonlinear_follower(
    candidate: Candidate, experiments: Sequence[Experiment], model: NonlinearModel
) -> Callable[[np.ndarray], tuple[np.ndarray, ...]]:
    """Simulated outputs (n_samples, n_y) of every recording as a function of theta, from the initial states
    that fit best at the values of the candidate; NaN where the model cannot be integrated."""
    problem, z = _begun(_problem(candidate, experiments, model))

    def at(theta: np.ndarray) -> tuple[np.ndarray, ...]:
        there = replace(problem, unknowns=replace(problem.unknowns, theta=theta))
        return _outputs(experiments, prediction_errors(there, z))

    return at


def _problem(
    candidate: Candidate, experiments: Sequence[Experiment], model: NonlinearModel
) -> TrajectoryProblem:
    flat = candidate.flat
    std = np.array([np.nan if output.noise_std is None else output.noise_std for output in flat.outputs])
    unknowns = Unknowns((), flat.theta_values, np.zeros(0), np.zeros(0))
    scale = np.ones(model.plain.explicit.n_states)
    problem = TrajectoryProblem(model.plain, tuple(experiments), candidate.hold, unknowns, scale, std)
    return replace(problem, state_scale=_sizes(problem, _starts(problem)))


def _starts(problem: TrajectoryProblem) -> np.ndarray:
    explicit = problem.model.explicit
    theta = problem.theta(np.zeros(0))
    if isinstance(explicit, ExplicitModel) and explicit.flat.events is not None:
        functions = EventFunctions(explicit)
        inputs = [inputs_and_slopes(explicit, e, problem.hold)[0] for e in problem.experiments]
        starts = zip(problem.experiments, inputs, strict=True)
        return np.array([settled_start(functions, theta, u, float(e.time[0]))[0] for e, u in starts])
    return np.array([initial_point(explicit, theta, e.inputs[0])[0] for e in problem.experiments])


def _sizes(problem: TrajectoryProblem, starts: np.ndarray) -> np.ndarray:
    """Largest absolute value of every state in a first simulation, 1 where there is none."""
    errors = prediction_errors(problem, starts.ravel())
    if errors is None:
        return np.ones(problem.n_states)
    size = np.max([np.max(np.abs(t.states), axis=0) for t in errors.trajectories], axis=0)
    return np.where(np.isfinite(size) & (size > 0.0), size, 1.0)


def _begun(problem: TrajectoryProblem) -> tuple[TrajectoryProblem, np.ndarray]:
    """The problem in the scales of the initial states that fit the recordings best, and these (n_z,)."""
    z = (_starts(problem) / problem.state_scale).ravel()
    scaled, found = begun_best(problem, *at_rest(problem, z, problem.long_past(z)), ITERATIONS)
    return (problem, z) if found is None else (scaled, found.z)


def _searched(problem: TrajectoryProblem, z: np.ndarray) -> np.ndarray:
    found = minimise(objective(problem), z, *limits(problem), ITERATIONS)
    return z if found is None else found.z


def _with_past(problem: TrajectoryProblem, z: np.ndarray) -> np.ndarray:
    """z (n_z,) with whatever long delays kept when the recordings began: what nobody recorded tells nothing
    against a model."""
    return _searched(problem, z) if np.any(problem.long_past(z)) else z


def _observer(candidate: Candidate, problem: TrajectoryProblem, simulated: Errors) -> Observer | None:
    """The gain at the noise levels of the candidate, linearised along the longest simulation."""
    longest = int(np.argmax([e.n_samples for e in problem.experiments]))
    experiment = problem.experiments[longest]
    explicit = problem.model.explicit
    ubar = inputs_and_slopes(explicit, experiment, problem.hold)
    states = simulated.trajectories[longest].states
    average = average_model(explicit, problem.theta(np.zeros(0)), experiment.time, states, ubar)
    intensity = np.array([noise.intensity or 0.0 for noise in candidate.flat.noises])
    return observer(average, intensity, problem.given_std)


def _outputs(experiments: Sequence[Experiment], errors: Errors | None) -> tuple[np.ndarray, ...]:
    if errors is None:
        return tuple(np.full(e.outputs.shape, np.nan) for e in experiments)
    return tuple(trajectory.outputs for trajectory in errors.trajectories)


def _variables(problem: TrajectoryProblem, errors: Errors | None) -> tuple[np.ndarray, ...]:
    """All internal variables (n_samples, n_v) without noise."""
    explicit = problem.model.explicit
    if errors is None:
        return tuple(np.full((e.n_samples, len(explicit.flat.unknowns)), np.nan) for e in problem.experiments)
    theta = problem.theta(np.zeros(0))
    return tuple(
        variables_along(
            explicit,
            theta if trajectory.modes is None else trajectory.modes.T,
            experiment,
            problem.hold,
            trajectory.states,
        )
        for experiment, trajectory in zip(problem.experiments, errors.trajectories, strict=True)
    )


def _slopes(
    candidate: Candidate, problem: TrajectoryProblem, model: NonlinearModel, z: np.ndarray, std: np.ndarray
) -> tuple[np.ndarray, ...]:
    """∂(error / std)/∂parameter (p, n_samples, n_y) of every recording."""
    p = len(candidate.parameter_names)
    errors = prediction_errors(replace(problem, model=model.sensitive), z, with_slopes=True) if p else None
    if errors is None:
        return ()
    return tuple(-t.sensitivities[:, :, :p].transpose(2, 0, 1) / std for t in errors.trajectories)


def _log_likelihood(errors: Errors, cov: np.ndarray) -> float:
    """Gaussian, for one-step errors of covariance `cov` (n_y, n_y); missing values are left out."""
    value = 0.0
    table = np.concatenate(errors.errors)
    observed = np.isfinite(table)
    for pattern in np.unique(observed, axis=0):
        rows = table[np.all(observed == pattern, axis=1)][:, pattern]
        root = np.linalg.cholesky(cov[np.ix_(pattern, pattern)])
        white = np.linalg.solve(root, rows.T)
        constant = 2.0 * np.log(np.diagonal(root)).sum() + pattern.sum() * np.log(2.0 * np.pi)
        value -= 0.5 * float(np.sum(white**2) + len(rows) * constant)
    return value


def _growth(candidate: Candidate, problem: TrajectoryProblem, predicted: Errors) -> tuple[Horizon, ...]:
    """Errors of simulations that start from predicted states, at STARTS_AHEAD samples of every recording."""
    steps = horizons(problem.experiments)
    squares, counts = np.zeros((2, len(steps), len(candidate.flat.outputs)))
    for experiment, trajectory in zip(problem.experiments, predicted.trajectories, strict=True):
        last = experiment.n_samples - max(steps)
        for start in np.unique(np.linspace(0, max(last, 0), STARTS_AHEAD).astype(int)):
            errors = _errors_ahead(problem, experiment, trajectory, int(start), max(steps))
            for i, h in enumerate(steps):
                row = errors[h - 1] if len(errors) >= h else np.full(errors.shape[1], np.nan)
                squares[i] += np.nan_to_num(row) ** 2
                counts[i] += np.isfinite(row)
    period = problem.experiments[0].median_step
    # The shortest one is known at every sample.
    table = np.concatenate(predicted.errors)
    squares[0], counts[0] = np.nansum(table**2, axis=0), np.isfinite(table).sum(axis=0)
    return growth_of(candidate.flat, steps, period, squares, counts)


def _errors_ahead(
    problem: TrajectoryProblem, experiment: Experiment, trajectory: Trajectory, start: int, length: int
) -> np.ndarray:
    """Errors (length, n_y) of a simulation from the predicted state of sample `start`; NaN where it fails."""
    rows = slice(start, start + length)
    try:
        ahead = integrate(
            problem.model,
            experiment.time[rows],
            experiment.inputs[rows],
            problem.theta(np.zeros(0)),
            trajectory.states[start],
            hold=problem.hold,
            state_scale=problem.state_scale,
        )
    except IntegrationError:
        return np.full(experiment.outputs[rows].shape, np.nan)
    return experiment.outputs[rows] - ahead.outputs
