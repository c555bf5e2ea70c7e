"""What a filter of a large model costs, told before it starts."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

LARGE = 150
"""From this many states on the cost is told."""

TRIAL = 400
"""Size of the matrix product that measures the speed of this machine."""

PRODUCTS = 30.0
"""Matrix products of the size of the state that one step of the time-varying filter takes, with its unknown
start: fitted to runs of ladders of 60 to 400 states."""

STATIONARY_PRODUCTS = 700.0
"""Matrix products that the stationary solution takes, once, whatever the length of the record."""


@dataclass(frozen=True)
class FilterCost:
    """Estimated `seconds` and `bytes` of memory."""

    seconds: float
    bytes: float


def filter_cost(n_states: int, n_unknowns: int, n_samples: int, is_stationary: bool) -> FilterCost:
    """Order of magnitude of the cost of a linear filter, from the speed of a matrix product measured now.

    The time-varying filter keeps one covariance of the state per sample until it is steady, in the worst case
    to the end of the record; the standard deviations of all unknowns take a product with each.
    """
    product = _seconds_of_product() * (n_states / TRIAL) ** 3
    distinct = 1 if is_stationary else n_samples
    steps = product * (STATIONARY_PRODUCTS if is_stationary else PRODUCTS * n_samples)
    spreads = product * distinct * n_unknowns / max(n_states, 1)
    numbers = 3.0 * distinct * n_states**2 + 20.0 * n_states**2 + 4.0 * n_samples * n_unknowns
    return FilterCost(steps + spreads, 8.0 * numbers)


def _seconds_of_product() -> float:
    matrix = np.ones((TRIAL, TRIAL))
    started = time.perf_counter()
    matrix @ matrix
    return time.perf_counter() - started
