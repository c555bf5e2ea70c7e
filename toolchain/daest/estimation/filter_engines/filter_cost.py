"""What a filter of a large model costs, told before it starts."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines.modes import has_equal_steps
from daest.model.experiment import Experiment

LARGE = 150
"""From this many states on the cost is told."""

TRIAL = 400
"""Size of the matrix product that measures the speed of this machine."""

STATIONARY_PRODUCTS = 250.0
"""Matrix products of the size of the state that the stationary solution takes, once, whatever the length of
the record: fitted to chains of springs of 300 and 1000 states, as the others below."""

STREAMED_PRODUCTS = 1.2
"""Those of each sample while the start is not known, in the worst case of all; one sample is kept at once."""

STORED_PRODUCTS = 60.0
"""Those of each sample where the covariances of all samples are kept."""

STORED_MATRICES = 14.0
"""Matrices of the size of the state that are then kept for each sample."""

Way = Literal["stationary", "streamed", "stored"]


@dataclass(frozen=True)
class FilterCost:
    """Estimated `seconds` and `bytes` of memory."""

    seconds: float
    bytes: float


def way_of_filter(kind: str, experiment: Experiment, measure: Sequence[str] | None, smooth: bool) -> Way:
    """How a filter of a large model runs: a time-varying one keeps the covariances of all samples where steps
    are uneven or values of the outputs `measure` (None: all) missing, and for a smoother."""
    if kind == "stationary":
        return "stationary"
    used = [i for i, name in enumerate(experiment.output_names) if measure is None or name in measure]
    is_plain = has_equal_steps(experiment.time) and not np.any(np.isnan(experiment.outputs[:, used]))
    return "streamed" if is_plain and not smooth else "stored"


def filter_cost(n_states: int, n_unknowns: int, n_samples: int, way: Way) -> FilterCost:
    """Order of magnitude of the cost of a linear filter, from the speed of a matrix product measured now."""
    product = _seconds_of_product() * (n_states / TRIAL) ** 3
    each = {"stationary": 0.0, "streamed": STREAMED_PRODUCTS, "stored": STORED_PRODUCTS}[way]
    stored = n_samples if way == "stored" else 1
    spreads = product * stored * n_unknowns / max(n_states, 1)
    numbers = STORED_MATRICES * stored * n_states**2 + 20.0 * n_states**2 + 4.0 * n_samples * n_unknowns
    numbers += 6.0 * n_unknowns * n_states
    return FilterCost(product * (STATIONARY_PRODUCTS + each * n_samples) + spreads, 8.0 * numbers)


def check_memory(cost: FilterCost) -> None:
    """Raises EstimationError `filter-too-large` where the filter would take more memory than there is."""
    available = _memory()
    if cost.bytes > available:
        raise EstimationError(
            "filter-too-large",
            f"this filter would take {cost.bytes / 1e9:.0f} GB of memory; there are {available / 1e9:.0f} GB",
            remedy="use --kind stationary, or equal steps, no missing values, and no --smooth",
        )


def _memory() -> float:
    """Bytes of memory of this machine, inf where it does not tell."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return float("inf")


def _seconds_of_product() -> float:
    matrix = np.ones((TRIAL, TRIAL))
    started = time.perf_counter()
    matrix @ matrix
    return time.perf_counter() - started
