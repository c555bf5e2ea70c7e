"""An affine model on recordings: exact simulation, Kalman prediction and its growth with the horizon."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.diagnosis.comparison.trial import Candidate, Trial, growth_of, horizons, variables_along
from daest.estimation.fitting.coordinates import Unknowns, parameter_coordinate
from daest.estimation.fitting.records import Record, make_record
from daest.estimation.linear.linear_predictors import (
    Innovations,
    Predicted,
    Problem,
    Recursion,
    innovation_slopes,
    predict,
    simulate,
)
from daest.model.comparison import Horizon
from daest.model.experiment import Experiment
from daest.model.flat import Dynamics
from daest.model.holds import ZOH
from daest.model.linear import StateSpaceFamily
from daest.systems.linear.linearize import is_affine_model
from daest.systems.linear.state_space import family_for, state_space, state_space_family


@dataclass(frozen=True)
class AffineModel:
    """A model whose states and outputs follow affine laws; `is_whole` tells whether all its variables do."""

    explicit: Dynamics
    family: StateSpaceFamily
    is_whole: bool


def affine_model(explicit: Dynamics) -> AffineModel:
    return AffineModel(explicit, state_space_family(explicit), is_affine_model(explicit.flat))


def affine_trial(candidate: Candidate, experiments: Sequence[Experiment], model: AffineModel) -> Trial:
    """Every recording simulated and predicted from the initial states that fit it best.

    A measurement noise that is not known is the one that the simulation leaves. Values are NaN where the
    model overflows, and there are no residuals where the Kalman filter does not settle.
    """
    family = model.family
    problem = _problem(candidate, family, experiments)
    z = problem.unknowns.start
    theta = problem.unknowns.values(z)[0]
    simulated = simulate(replace(problem, begins_level=True), theta, problem.unknowns.measurement_std)
    if simulated is not None:
        known = replace(problem.unknowns, measurement_std=simulated.measurement_std)
        problem = replace(problem, unknowns=known, weigh=np.zeros_like(problem.weigh))
    predicted = predict(problem, z, with_slopes=bool(z.size))
    if predicted is None and z.size:
        problem = replace(problem, unknowns=replace(problem.unknowns, coordinates=(), theta=theta))
        predicted = predict(problem, np.zeros(0))
    states = _states(problem, predicted)
    return Trial(
        simulated=_outputs(problem, simulated),
        predicted=_outputs(problem, predicted),
        residuals=() if predicted is None else _residuals(problem, predicted),
        variable_names=family.unknown_names,
        variable_units=tuple(v.unit for v in family.unknowns),
        simulated_variables=_variables(model, problem, experiments, theta, _states(problem, simulated)),
        predicted_variables=_variables(model, problem, experiments, theta, states),
        slopes=() if predicted is None else _slopes(problem, predicted),
        initial_states=() if predicted is None else predicted.initial_states,
        growth=()
        if predicted is None
        else _growth(candidate, problem, predicted, states, horizons(experiments)),
        log_likelihood=np.nan if predicted is None else -predicted.negative_log_likelihood,
        is_output_error=not np.any(problem.unknowns.intensity),
        known_noise=np.array([o.noise_std is not None for o in family.outputs], dtype=bool),
        acts_at_once=candidate.hold != ZOH or bool(np.any(state_space(family, theta).D)),
        notes=()
        if predicted
        else ("no one-step prediction: the Kalman filter does not settle at these values",),
    )


def affine_follower(
    candidate: Candidate, experiments: Sequence[Experiment], model: AffineModel
) -> Callable[[np.ndarray], tuple[np.ndarray, ...]]:
    """Simulated outputs (n_samples, n_y) of every recording as a function of theta, from the initial states
    that fit best there; NaN where the model overflows."""
    problem = _problem(replace(candidate, parameter_names=()), model.family, experiments)
    std = problem.unknowns.measurement_std

    def at(theta: np.ndarray) -> tuple[np.ndarray, ...]:
        return _outputs(problem, simulate(replace(problem, begins_level=True), theta, std))

    return at


def _problem(candidate: Candidate, family: StateSpaceFamily, experiments: Sequence[Experiment]) -> Problem:
    flat = candidate.flat
    unknown = np.array([output.noise_std is None for output in flat.outputs], dtype=bool)
    value = {p.name: p.value for p in flat.parameters}
    unknowns = Unknowns(
        coordinates=tuple(
            parameter_coordinate(family, name, value[name], (None, None))
            for name in candidate.parameter_names
        ),
        theta=flat.theta_values,
        intensity=np.array([noise.intensity or 0.0 for noise in flat.noises], dtype=float),
        measurement_std=np.array([output.noise_std or 0.0 for output in flat.outputs], dtype=float),
    )
    family = family_for(family, candidate.hold)
    records = tuple(make_record(experiment, family, candidate.hold) for experiment in experiments)
    return Problem(family, records, candidate.hold, unknowns, unknown, candidate.sampled)


def _states(problem: Problem, found: Predicted | None) -> tuple[np.ndarray, ...]:
    """States (n_grid, n) of every record on its grid, before the correction by the sample."""
    if found is None:
        n = len(problem.family.state_names)
        return tuple(np.full((record.n_samples, n), np.nan) for record in problem.records)
    return tuple(
        part.states_at_zero + np.tensordot(x0, part.states_response, 1)
        for part, x0 in zip(found.found, found.initial_states, strict=True)
    )


def _outputs(problem: Problem, found: Predicted | None) -> tuple[np.ndarray, ...]:
    """Model outputs (n_samples, n_y) of every record at the recorded times."""
    if found is None:
        n_y = len(problem.family.outputs)
        return tuple(np.full((record.recorded.size, n_y), np.nan) for record in problem.records)
    rows = zip(problem.records, found.recursions, _states(problem, found), strict=True)
    return tuple(
        (states @ dyn.C.T + record.inputs @ dyn.D.T + dyn.d)[record.recorded] for record, dyn, states in rows
    )


def _variables(
    model: AffineModel,
    problem: Problem,
    experiments: Sequence[Experiment],
    theta: np.ndarray,
    states: Sequence[np.ndarray],
) -> tuple[np.ndarray, ...]:
    """All internal variables (n_samples, n_v) of every record at the recorded times."""
    if not model.is_whole:
        return tuple(
            variables_along(model.explicit, theta, experiment, problem.hold, x[record.recorded])
            for experiment, record, x in zip(experiments, problem.records, states, strict=True)
        )
    ss = state_space(problem.family, theta)
    return tuple(
        (x @ ss.X.T + record.inputs @ ss.U.T + ss.x0)[record.recorded]
        for record, x in zip(problem.records, states, strict=True)
    )


def _std(found: Innovations) -> np.ndarray:
    """Predicted standard deviation of every one-step error, (n_y,) or (n_samples, n_y)."""
    assert found.S is not None
    return np.sqrt(np.diagonal(found.S, axis1=-2, axis2=-1))


def _residuals(problem: Problem, predicted: Predicted) -> tuple[np.ndarray, ...]:
    result = []
    for record, part, x0 in zip(problem.records, predicted.found, predicted.initial_states, strict=True):
        residuals = (part.at_zero - np.tensordot(x0, part.response, 1)) / _std(part)
        result.append(np.where(record.observed, residuals, np.nan)[record.recorded])
    return tuple(result)


def _slopes(problem: Problem, predicted: Predicted) -> tuple[np.ndarray, ...]:
    """∂residual/∂parameter of every record, (p, n_samples, n_y)."""
    if not problem.unknowns.coordinates:
        return ()
    rows = zip(problem.records, predicted.recursions, predicted.found, predicted.initial_states, strict=True)
    return tuple(
        (innovation_slopes(dyn, record, part, x0) / _std(part))[:, record.recorded]
        for record, dyn, part, x0 in rows
    )


def _growth(
    candidate: Candidate,
    problem: Problem,
    predicted: Predicted,
    states: Sequence[np.ndarray],
    steps: Sequence[int],
) -> tuple[Horizon, ...]:
    squares, counts = np.zeros((2, len(steps), len(problem.family.outputs)))
    for record, dyn, x in zip(problem.records, predicted.recursions, states, strict=True):
        for i, (errors, seen) in enumerate(_errors_ahead(record, dyn, x, steps)):
            squares[i] += np.sum(np.where(seen, errors, 0.0) ** 2, axis=0)
            counts[i] += seen.sum(axis=0)
    period = (
        float(np.median(np.diff(problem.records[0].time))) if problem.records[0].n_samples > 1 else np.nan
    )
    return growth_of(candidate.flat, steps, period, squares, counts)


def _errors_ahead(
    record: Record, dyn: Recursion, states: np.ndarray, steps: Sequence[int]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Errors (n, n_y) of all predictions that use samples up to k - 1 for sample k - 1 + h, for every h in
    `steps` in turn, and which of them were measured."""
    u, n = record.inputs, record.n_samples
    drive = _each_step(dyn.now, u[:-1]) + _each_step(dyn.following, u[1:]) + dyn.drift
    known = record.outputs - u @ dyn.D.T - dyn.d
    x = states
    for ahead in range(max(steps)):
        if ahead + 1 in steps:
            yield known[ahead:] - x @ dyn.C.T, record.observed[ahead:]
        if ahead + 1 >= n:
            return
        phi = dyn.Phi if dyn.Phi.ndim == 2 else dyn.Phi[ahead:]
        x = _each_step(phi, x[:-1]) + drive[ahead:]


def _each_step(matrix: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """matrix · row for every row; `matrix` (a, b), or one per row."""
    return rows @ matrix.T if matrix.ndim == 2 else (matrix @ rows[..., None])[..., 0]
