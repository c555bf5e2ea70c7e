"""What a model says about recordings: simulations, one-step predictions, and what errors are held against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from daest.estimation.fitting.fitted import fitted_model
from daest.estimation.fitting.result import agreement_of
from daest.model.comparison import Horizon
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FitResult
from daest.model.flat import Dynamics, Model
from daest.model.holds import Hold
from daest.systems.simulation.integrate import interval_inputs
from daest.systems.simulation.simulate import values_along

HORIZONS = (1, 3, 10, 30, 100, 300)  # samples, as far as LONGEST_HORIZON allows
LONGEST_HORIZON = 0.1  # of the longest recording


@dataclass(frozen=True)
class Candidate:
    """A model with the values that it is tried at. `n_parameters` of them were estimated; `hold` and
    `sampled` (process noise white or held over a sample) are those of its fit.

    `parameter_cov` (p, p) is the covariance of the estimates `parameter_names`, and `n_estimation` the
    number of samples that they and the noises come from; without them the values count as exact.
    """

    name: str
    flat: Model
    n_parameters: int
    hold: Hold = "foh"
    sampled: Literal["white", "held"] = "white"
    notes: tuple[str, ...] = ()
    parameter_names: tuple[str, ...] = ()
    parameter_cov: np.ndarray | None = None
    n_estimation: int | None = None


def fitted_candidate(
    flat: Model, fit: FitResult, hold: Hold | None = None, name: str | None = None
) -> Candidate:
    """The model as `fit` leaves it, with the uncertainty of the estimates, so that the tests of other
    recordings allow for it. `hold` None takes that of the fit."""
    names, cov = fit.covariance()
    return Candidate(
        name=name or flat.name,
        flat=fitted_model(flat, fit),
        n_parameters=len(fit.parameters),
        hold=hold or fit.hold,
        sampled=fit.noise_model,
        parameter_names=names,
        parameter_cov=cov if names else None,
        n_estimation=fit.n_samples,
    )


@dataclass(frozen=True)
class Trial:
    """One model on all recordings; tuples hold one array per recording, over its samples.

    `simulated`, `predicted` (n_samples, n_y) in the units of the outputs. `residuals` (n_samples, n_y) are
    the one-step errors over their predicted standard deviation, NaN where missing; () without a predictor.
    `simulated_variables`, `predicted_variables` (n_samples, n_v) are all internal variables. `slopes`
    (p, n_samples, n_y) are ∂residuals/∂parameter for the candidate's `parameter_names`, () where unknown.
    `initial_states` are those of the predictor. `known_noise` (n_y,) tells whose noise was not read off
    these data; `acts_at_once` whether an input moves an output of the same sample.
    """

    simulated: tuple[np.ndarray, ...]
    predicted: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    variable_names: tuple[str, ...]
    variable_units: tuple[str, ...]
    simulated_variables: tuple[np.ndarray, ...]
    predicted_variables: tuple[np.ndarray, ...]
    slopes: tuple[np.ndarray, ...]
    initial_states: tuple[np.ndarray, ...]
    growth: tuple[Horizon, ...]
    log_likelihood: float
    is_output_error: bool
    known_noise: np.ndarray
    acts_at_once: bool
    notes: tuple[str, ...] = ()


def agreement(flat: Model, experiments: Sequence[Experiment], outputs: Sequence[np.ndarray]) -> Agreement:
    """100 (1 - |y - ŷ| / |y - mean y|) and rms per output; the mean is that of each recording. Shapes:
    outputs ŷ (n_samples, n_y) per experiment."""
    measured = [e.outputs for e in experiments]
    errors = [y - simulated for y, simulated in zip(measured, outputs, strict=True)]
    # An output is not known where it was measured and the simulation has no value.
    squares = [np.where(np.isfinite(y), error, 0.0) ** 2 for y, error in zip(measured, errors, strict=True)]
    lost = ~np.isfinite(np.sum([np.sum(one, axis=0) for one in squares], axis=0))
    names = [output.name for output in flat.outputs]
    return agreement_of(names, measured, [np.where(lost, np.nan, error) for error in errors])


def inputs_and_slopes(explicit: Dynamics, experiment: Experiment, hold: Hold) -> np.ndarray:
    """Inputs and their slopes at every sample, (n_samples, n_ū)."""
    u0, _ = interval_inputs(explicit, experiment.time, experiment.inputs, hold)
    last = np.hstack([experiment.inputs[-1:], u0[-1:, experiment.inputs.shape[1] :]])
    return np.vstack([u0, last])


def variables_along(
    explicit: Dynamics, theta: np.ndarray, experiment: Experiment, hold: Hold, states: np.ndarray
) -> np.ndarray:
    """All internal variables (n_samples, n_v) without noise, along states (n_samples, n)."""
    ubar = inputs_and_slopes(explicit, experiment, hold)
    return values_along(explicit, experiment.time, ubar, theta, states, hold)[1]


def horizons(experiments: Sequence[Experiment]) -> tuple[int, ...]:
    """Steps of the predictions whose error is told."""
    longest = max(e.n_samples for e in experiments)
    return tuple(h for h in HORIZONS if h == 1 or h <= LONGEST_HORIZON * longest)


def growth_of(
    flat: Model, steps: Sequence[int], period: float, squares: np.ndarray, counts: np.ndarray
) -> tuple[Horizon, ...]:
    """rms errors from sums of squares and counts (n_horizons, n_y); `period` [s] is that of one step."""
    names = flat.output_names
    return tuple(
        Horizon(
            steps=h,
            seconds=h * period,
            rms={
                name: float(np.sqrt(s / n)) if n and np.isfinite(s) else None
                for name, s, n in zip(names, squares[i], counts[i], strict=True)
            },
        )
        for i, h in enumerate(steps)
    )
