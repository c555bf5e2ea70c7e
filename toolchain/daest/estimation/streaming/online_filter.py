"""The filter of a model that takes samples one by one, of the kind that is asked for."""

from __future__ import annotations

from typing import Literal

import numpy as np

from daest.estimation.filters.case import AnyModel, FilterModel, linear_refused
from daest.estimation.streaming.online import OnlineFilter
from daest.estimation.streaming.online_gaussian import online_gaussian
from daest.estimation.streaming.online_kalman import online_kalman
from daest.model.estimates import FilterOptions
from daest.model.flat import FlatModel
from daest.systems.events.modes import in_starting_mode

OnlineKind = Literal["time-varying", "stationary", "ekf", "ukf"]


def online_filter(
    model: AnyModel, period: float, kind: OnlineKind | None = None, options: FilterOptions | None = None
) -> OnlineFilter:
    """The filter of `model`, with all its outputs, for steps of about `period` [s].

    `kind` None: time-varying for an affine model, ekf for another, and for one with events. Of `options` the
    numbers, the start, the hold and the longest substep are used. Raises EstimationError `filter-events` and
    what `FilterModel.of`, `online_kalman` and `online_gaussian` raise.
    """
    options = options or FilterOptions()
    if isinstance(model, FlatModel) and model.events is not None:
        if kind in ("time-varying", "stationary"):
            raise linear_refused(kind)
        kind, model = kind or "ekf", in_starting_mode(model, theta=options.theta)
    ready = FilterModel.of(model, options)
    if ready.flat is not None:
        ready.flat.refuse_hidden_states("filter")
    chosen = kind or ("time-varying" if ready.is_affine else "ekf")
    if chosen == "time-varying" or chosen == "stationary":
        return online_kalman(
            ready.linear, ready.intensity, ready.cov, period,
            kind=chosen, hold=options.hold, initial=options.initial, units=ready.units,
        )  # fmt: skip
    intensity, variance = ready.independent_noise()
    return online_gaussian(
        ready.explicit, ready.theta, intensity, np.sqrt(variance), period,
        kind=chosen, hold=options.hold, initial=options.initial, longest=options.longest,
    )  # fmt: skip
