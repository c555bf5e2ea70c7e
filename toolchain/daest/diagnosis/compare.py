"""Models side by side on recordings: simulation from the best initial state, and one-step prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from daest.diagnosis.nonlinear_trial import simulated_trial
from daest.estimation import likelihood, output_error
from daest.estimation.agreement import predicted_agreement, simulated_agreement
from daest.estimation.coordinates import Unknowns
from daest.estimation.output_error import Problem
from daest.estimation.predictor import Dynamics, Innovations
from daest.estimation.records import Record, make_record
from daest.model.comparison import Comparison, ModelTrial
from daest.model.experiment import Experiment
from daest.model.fit import Agreement
from daest.model.flat import FlatModel
from daest.systems.linearize import is_affine_model
from daest.systems.state_space import state_space_family

Hold = Literal["zoh", "foh"]
Sampled = Literal["white", "held"]

_NOTHING = np.zeros(0)  # the search coordinates of a problem in which nothing is searched


@dataclass(frozen=True)
class Candidate:
    """A model with the values that it is tried at. `n_parameters` of them were estimated; `hold` and
    `sampled` (process noise white or held over a sample) are those of its fit."""

    name: str
    flat: FlatModel
    n_parameters: int
    hold: Hold = "foh"
    sampled: Sampled = "white"
    notes: tuple[str, ...] = ()


def compare_models(candidates: Sequence[Candidate], experiments: Sequence[Experiment]) -> Comparison:
    """Every candidate on all experiments; outputs are those of the first candidate, which all must have.

    A measurement noise that is not known is the one that the simulation leaves. Values are NaN and
    agreements None where a model overflows.
    """
    outputs = candidates[0].flat.outputs
    return Comparison(
        experiments=tuple(experiments),
        output_names=tuple(output.name for output in outputs),
        output_units=tuple(output.unit for output in outputs),
        models=tuple(_trial(candidate, experiments) for candidate in candidates),
    )


def _trial(candidate: Candidate, experiments: Sequence[Experiment]) -> ModelTrial:
    if is_affine_model(candidate.flat):
        return _affine_trial(candidate, experiments)
    found = simulated_trial(candidate.flat, experiments, candidate.hold)
    names = [output.name for output in candidate.flat.outputs]
    return ModelTrial(
        name=candidate.name,
        n_parameters=candidate.n_parameters,
        simulation=found.agreement,
        one_step=Agreement(dict.fromkeys(names), dict.fromkeys(names)),
        log_likelihood=np.nan,
        bic=np.nan,
        simulated=found.outputs,
        predicted=tuple(np.full(outputs.shape, np.nan) for outputs in found.outputs),
        notes=(*candidate.notes, "nonlinear: compared by simulation alone"),
    )


def _affine_trial(candidate: Candidate, experiments: Sequence[Experiment]) -> ModelTrial:
    problem = _problem(candidate, experiments)
    simulated = output_error.simulate(problem, problem.unknowns.theta, problem.unknowns.measurement_std)
    if simulated is not None:
        known = replace(problem.unknowns, measurement_std=simulated.measurement_std)
        problem = replace(problem, unknowns=known, weigh=np.zeros_like(problem.weigh))
    predicted = likelihood.predict(problem, _NOTHING)
    log_likelihood = np.nan if predicted is None else -predicted.negative_log_likelihood
    n_values = sum(int(record.n_observed.sum()) for record in problem.records)
    notes = list(candidate.notes)
    if predicted is None:
        notes.append("no one-step prediction: the Kalman filter does not settle at these values")
    return ModelTrial(
        name=candidate.name,
        n_parameters=candidate.n_parameters,
        simulation=simulated_agreement(problem, problem.records, _NOTHING),
        one_step=predicted_agreement(problem, problem.records, _NOTHING),
        log_likelihood=float(log_likelihood),
        bic=float(candidate.n_parameters * np.log(n_values) - 2.0 * log_likelihood),
        simulated=_outputs(problem, simulated),
        predicted=_outputs(problem, predicted),
        notes=tuple(notes),
    )


def _problem(candidate: Candidate, experiments: Sequence[Experiment]) -> Problem:
    flat = candidate.flat
    family = state_space_family(flat)
    unknown = np.array([output.noise_std is None for output in flat.outputs], dtype=bool)
    unknowns = Unknowns(
        coordinates=(),
        theta=flat.theta_values,
        intensity=np.array([noise.intensity or 0.0 for noise in flat.noises], dtype=float),
        measurement_std=np.array([output.noise_std or 0.0 for output in flat.outputs], dtype=float),
    )
    records = tuple(make_record(experiment, family) for experiment in experiments)
    return Problem(family, records, candidate.hold, unknowns, unknown, candidate.sampled)


def _outputs(
    problem: Problem, found: output_error.Simulated | likelihood.Predicted | None
) -> tuple[np.ndarray, ...]:
    """Model outputs (n_samples, n_y) of every record at the recorded times."""
    if found is None:
        n_y = len(problem.family.outputs)
        return tuple(np.full((record.recorded.size, n_y), np.nan) for record in problem.records)
    rows = zip(problem.records, found.dynamics, found.found, found.initial_states, strict=True)
    return tuple(_record_outputs(record, dyn, part, x0) for record, dyn, part, x0 in rows)


def _record_outputs(record: Record, dyn: Dynamics, part: Innovations, x0: np.ndarray) -> np.ndarray:
    states = part.states_at_zero + np.tensordot(x0, part.states_response, 1)
    outputs = states @ dyn.C.T + record.inputs @ dyn.D.T + dyn.d
    return outputs[record.recorded]
