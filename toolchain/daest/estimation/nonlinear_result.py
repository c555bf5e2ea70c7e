"""From the end of a nonlinear search to a FitResult: estimates, uncertainty, noise levels, agreement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daest.estimation.coordinates import prior_precisions
from daest.estimation.gain_family import Levels
from daest.estimation.gaussian import objective
from daest.estimation.identifiability import (
    Scores,
    covariance,
    output_error_covariance,
    scores,
    std_errors,
    without_influence,
)
from daest.estimation.noise_levels import Ending, NonlinearSetup, average_along
from daest.estimation.nonlinear_start import consistent_states, fit_initial_states, limits
from daest.estimation.observer import AverageModel
from daest.estimation.result import (
    COLOURED,
    End,
    Told,
    agreement_of,
    assembled,
    bound_of,
    fitted_initial_state,
)
from daest.estimation.search import minimise
from daest.estimation.shooting import whole_errors
from daest.estimation.stationary import unseen_directions
from daest.estimation.trajectories import Errors, TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FitResult, FittedNoise
from daest.model.flat import Dynamics

AGREEMENT_ITERATIONS = 10  # of the search for the initial states that an agreement is judged from
SWITCHES = (
    "the model changes at events, so that its likelihood may have valleys of its own between them, and "
    "intervals that are too narrow in a wrong one: compare the ends from several starts (--starts 8)"
)
AGREEMENT_GAIN = 0.1  # predicted gain in log-likelihood that ends it: 1e-5 of the error


def agreement(
    end: Ending, experiments: tuple[Experiment, ...], *, with_gain: bool, at_rest: Sequence[str] = ()
) -> Agreement:
    """Agreement from the best initial state of each experiment, parameters held; the states `at_rest` start
    at zero."""
    names = [o.name for o in end.problem.model.explicit.flat.outputs]
    measured = [e.outputs for e in experiments]
    if end.cut is not None and experiments is end.problem.experiments:
        return agreement_of(names, measured, whole_errors(end.cut)[0].errors)
    problem = end.problem if with_gain else replace(end.problem, gain=None)
    n = len(problem.unknowns.coordinates)
    is_fitted = experiments is end.problem.experiments
    if is_fitted and (with_gain or end.problem.gain is None):
        # What was searched: the initial states are the best ones.
        errors = prediction_errors(problem, end.found.z)
        return agreement_of(names, measured, None if errors is None else errors.errors)
    problem = replace(problem, experiments=experiments).held_at(end.found.z)
    z = (
        end.found.z[n:]
        if is_fitted
        else (consistent_states(problem, np.zeros(0)) / problem.state_scale).ravel()
    )
    lower, upper = limits(problem)
    if at_rest:
        rests = np.tile(np.isin(problem.model.explicit.state_names, at_rest), len(experiments))
        lower, upper, z = (np.where(rests, 0.0, part) for part in (lower, upper, z))
    if not is_fitted:
        z = fit_initial_states(problem, z, lower, upper)
    found = minimise(objective(problem), z, lower, upper, AGREEMENT_ITERATIONS, AGREEMENT_GAIN)
    errors = None if found is None else prediction_errors(problem, found.z)
    return agreement_of(names, measured, None if errors is None else errors.errors)


def nonlinear_result(
    setup: NonlinearSetup,
    ends: list[Ending],
    simulated: dict[str, Agreement],
    one_step: dict[str, Agreement],
) -> FitResult:
    """The best of `ends`, with its uncertainty by report (2): inverse information, or the sandwich for
    coloured residuals of a simulation."""
    end = ends[0]
    problem, unknowns, found = end.problem, end.problem.unknowns, end.found
    n = len(unknowns.coordinates)
    explicit = problem.model.explicit
    errors, parts = _judged_errors(end)
    slopes = unknowns.slopes(found.z[:n])
    bounds = [bound_of(c, z) for c, z in zip(unknowns.coordinates, found.z[:n], strict=True)]
    information = np.sum([np.tensordot(s.slopes, s.slopes, ((1, 2), (1, 2))) for s in parts], axis=0)
    observed = [np.isfinite(e.outputs) for e in problem.experiments]
    count = sum(int(o.sum()) for o in observed)
    in_z = information * np.outer(slopes, slopes) + np.diag(prior_precisions(unknowns))
    free = ~without_influence(in_z, count) & np.array([b is None for b in bounds], dtype=bool)
    notes = [*setup.notes, *end.notes]
    if explicit.flat.events is not None and len(ends) == 1:
        notes.append(SWITCHES)
    if setup.method == "oe":
        uncertain = output_error_covariance(parts, observed, slopes, free, prior_precisions(unknowns))
        cov_z = uncertain.covariance
        if uncertain.is_coloured:
            notes.append(COLOURED)
    else:
        cov_z = covariance(in_z, free)
    cov = cov_z * np.outer(slopes, slopes)
    values = unknowns.natural(found.z[:n])
    average = average_along(problem, found.z)
    names = explicit.state_names
    told = Told(
        method=setup.method,
        theta=problem.theta(found.z),
        noises=fitted_noises(setup, end, errors.covariance, count),
        noise_model="white",
        initial_states=tuple(
            fitted_initial_state(experiment.name, names, x0, part, cov)
            for experiment, part, x0 in zip(
                problem.experiments, parts, problem.initial_states(found.z), strict=True
            )
        ),
        simulated=simulated,
        one_step=one_step,
        n_samples=sum(e.n_samples for e in problem.experiments),
        hold=problem.hold,
        notes=tuple(notes),
        unseen=() if average is None else _unseen(explicit, average),
    )
    judged = End(unknowns, values, cov, std_errors(cov, values), bounds, in_z)
    return assembled(judged, [e.found for e in ends], explicit.flat.parameters, problem.experiments, told)


def _unseen(explicit: Dynamics, average: AverageModel) -> tuple[str, ...]:
    return unseen_directions(average.A, average.C, average.period, explicit.state_names)


def _judged_errors(end: Ending) -> tuple[Errors, list[Scores]]:
    if end.cut is not None:
        return whole_errors(end.cut, with_slopes=True)
    errors = prediction_errors(end.problem, end.found.z, with_slopes=True)
    assert errors is not None
    return errors, all_scores(end.problem, errors)


def all_scores(problem: TrajectoryProblem, errors: Errors) -> list[Scores]:
    """Whitened residuals with slopes per unit of the parameters, initial states projected out."""
    n = len(problem.unknowns.coordinates)
    root = np.linalg.inv(np.linalg.cholesky(errors.covariance)).T
    parts = []
    for error, trajectory in zip(errors.errors, errors.trajectories, strict=True):
        observed = np.isfinite(error)
        change = np.where(observed, -trajectory.sensitivities.transpose(2, 0, 1), 0.0) @ root
        residuals = np.where(observed, error, 0.0) @ root
        parts.append(scores(residuals, -change[n:], change[:n]))
    return parts


def fitted_noises(
    setup: NonlinearSetup, end: Ending, innovation_cov: np.ndarray, count: int
) -> tuple[FittedNoise, ...]:
    """Without a gain the errors are measurement noise; with one, the levels behind the gain."""
    flat = end.problem.model.explicit.flat
    levels = end.levels or Levels(np.full(len(flat.noises), np.nan), np.sqrt(np.diagonal(innovation_cov)))
    std = levels.measurement_std
    per_output = max(count / max(std.size, 1), 1.0)
    process = (
        FittedNoise(w.name, "process", float(q), None, w.unit, bool(estimated), None)
        for w, q, estimated in zip(flat.noises, levels.intensity, setup.estimate_intensity, strict=True)
        if np.isfinite(q)
    )
    measurement = (
        FittedNoise(
            o.name,
            "measurement",
            float(s),
            float(s / np.sqrt(2.0 * per_output)) if np.isnan(given) else None,
            o.unit,
            bool(np.isnan(given)),
            None,
        )
        for o, s, given in zip(flat.outputs, std, setup.given_std, strict=True)
    )
    return (*process, *measurement)
