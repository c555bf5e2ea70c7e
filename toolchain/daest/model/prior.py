"""Prior: what is known of a parameter beforehand."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Prior:
    """In the unit of the parameter: a normal density; where the parameter is searched on a logarithmic
    scale a lognormal one with the median `mean` and the relative standard deviation `std / mean`."""

    mean: float
    std: float
