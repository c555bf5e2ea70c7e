"""Prior: what is known of a parameter beforehand."""

from __future__ import annotations

from dataclasses import dataclass

from daest.errors import EstimationError


@dataclass(frozen=True)
class Prior:
    """In the unit of the parameter: a normal density; where the parameter is searched on a logarithmic
    scale a lognormal one with the median `mean` and the relative standard deviation `std / mean`."""

    mean: float
    std: float


def prior_unused(name: str) -> EstimationError:
    """The error for a prior on a parameter that is not estimated."""
    return EstimationError(
        "prior-unused",
        f"{name} has a prior but is not estimated",
        where=name,
        remedy=f"estimate it (--estimate {name}), or leave the prior out",
    )
