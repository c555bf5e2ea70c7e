"""One-step predictions of a model with events and process noise: by the extended filter that follows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daest.diagnosis.comparison.trial import Candidate, Trial, inputs_and_slopes
from daest.errors import EstimationError
from daest.estimation.filter_engines.ekf import EkfRun, run_ekf
from daest.estimation.filters.case import Case, FilterModel
from daest.estimation.filters.local import prepared
from daest.model.estimates import FilterOptions
from daest.model.experiment import Experiment
from daest.model.flat import Dynamics
from daest.systems.events.integration import IntegrationError
from daest.systems.simulation.simulate import values_along

FILTERED = "one-step errors are those of the extended filter, which follows the events"
NOT_FILTERED = "no one-step prediction: the extended filter does not follow the model over the recordings"


def with_predictions(
    trial: Trial, candidate: Candidate, experiments: Sequence[Experiment], explicit: Dynamics
) -> Trial:
    """The trial of a simulation, with the predictions of the extended filter. Errors of several outputs at
    one sample are each given the ones before it, which makes them independent."""
    model = FilterModel.of(explicit, FilterOptions())
    names = explicit.flat.output_names
    options = FilterOptions(hold=candidate.hold)
    predicted, variables, residuals, starts, value = [], [], [], [], 0.0
    try:
        for e in experiments:
            task = prepared(Case(model, e, names, options, lambda _: None)).task
            run = run_ekf(task.model, task.data, task.theta, task.noise, task.start)
            outputs, inside = _along(explicit, e, candidate, run)
            predicted.append(outputs)
            variables.append(inside)
            residuals.append(run.innovations / np.sqrt(run.variances))
            starts.append(run.filtered[0])
            value += run.log_likelihood
    except (IntegrationError, EstimationError):
        return replace(trial, notes=(*trial.notes, NOT_FILTERED))
    return replace(
        trial,
        predicted=tuple(predicted),
        predicted_variables=tuple(variables),
        residuals=tuple(residuals),
        initial_states=tuple(starts),
        log_likelihood=value,
        notes=(*trial.notes, FILTERED),
    )


def _along(
    explicit: Dynamics, experiment: Experiment, candidate: Candidate, run: EkfRun
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs and internal variables at the predicted states, in the modes of the filter."""
    assert run.modes is not None
    ubar = inputs_and_slopes(explicit, experiment, candidate.hold)
    return values_along(explicit, experiment.time, ubar, run.modes.T, run.predicted, candidate.hold)
