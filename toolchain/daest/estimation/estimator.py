"""The parts of an exported estimator: the linear filter of a model with its start and its noise levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filters.case import FilterModel
from daest.estimation.online_kalman import online_kalman
from daest.fmu.estimator_code import EstimatorModel, EstimatorStart, chosen_values
from daest.model.estimates import FilterKind, FilterOptions, InitialState
from daest.model.flat import Model, events_refused, with_equations
from daest.systems.linearize import is_affine_model
from daest.systems.state_space import state_space_family

EstimatorKind = Literal["stationary", "kalman", "ekf", "ukf"]
FILTER_OF: dict[str, FilterKind] = {"kalman": "time-varying", "stationary": "stationary"}


def estimator_model(
    flat: Model,
    period: float,
    kind: EstimatorKind | None = None,
    hold: Literal["zoh", "foh"] = "foh",
    only: Sequence[str] = (),
    initial: InitialState | None = None,
) -> EstimatorModel:
    """The estimator of `flat` with its parameters and noises, for steps of about `period` [s].

    `only` names the variables that it tells. Raises FmuError `fmu-no-equations`, EstimationError
    `estimator-nonlinear`, `filter-unknown-variable`, `filter-noise-unknown` and those of `online_kalman`.
    """
    with_equations(flat, "the export of an estimator")
    if flat.events is not None:
        raise events_refused("an exported estimator")
    chosen = kind or "kalman"
    if chosen not in FILTER_OF or not is_affine_model(flat):
        raise EstimationError(
            "estimator-nonlinear",
            f"an estimator of kind {chosen} of {'a' if is_affine_model(flat) else 'a nonlinear'} model is "
            f"not "
            "exported",
            where=flat.name,
            remedy="export the kalman or stationary estimator of a linear model; daest filter --follow runs "
            "the "
            "others",
        )
    family = state_space_family(flat)
    ready = FilterModel.of(flat, FilterOptions(hold=hold))
    online = online_kalman(
        ready.linear, ready.intensity, ready.cov, period, kind=FILTER_OF[chosen], hold=hold, initial=initial
    )
    first = online.first
    start = EstimatorStart(
        first.mean, first.cov, first.sensitivity, first.root.shape[0], first.log_density, online.scale
    )
    intensity, variance = ready.independent_noise()
    return EstimatorModel(
        flat.name, family, ready.theta, intensity, np.sqrt(variance), period, hold, online.noise == "held",
        chosen_values(family, only), start,
    )  # fmt: skip
