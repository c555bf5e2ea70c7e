"""The filter of a model that takes samples one by one, of the kind that is asked for."""

from __future__ import annotations

from typing import Literal

import numpy as np

from daest.estimation.filters.case import AnyModel, FilterModel
from daest.estimation.online import OnlineFilter
from daest.estimation.online_gaussian import online_gaussian
from daest.estimation.online_kalman import online_kalman
from daest.model.estimates import FilterOptions
from daest.model.flat import events_refused

OnlineKind = Literal["time-varying", "stationary", "ekf", "ukf"]


def online_filter(
    model: AnyModel, period: float, kind: OnlineKind | None = None, options: FilterOptions | None = None
) -> OnlineFilter:
    """The filter of `model`, with all its outputs, for steps of about `period` [s].

    `kind` None: time-varying for an affine model, ekf for another. Of `options` the numbers, the start, the
    hold and the longest substep are used. Raises ModelError `events-not-supported` and what
    `FilterModel.of`, `online_kalman` and `online_gaussian` raise.
    """
    options = options or FilterOptions()
    ready = FilterModel.of(model, options)
    if ready.flat is not None and ready.flat.events is not None:
        raise events_refused("a filter")
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
