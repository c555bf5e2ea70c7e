"""The registry of filters. A new filter is a file in this folder, with a function `estimate`, and a row
here."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Filter:
    """A filter by its name, and the file of this folder whose `estimate(case, name)` runs it and returns
    `Estimates`. A filter that `is_linear` sees the model linearised at its operating point."""

    name: str
    file: str
    is_linear: bool = False


FILTERS = {
    row.name: row
    for row in (
        Filter("time-varying", "kalman", is_linear=True),
        Filter("stationary", "kalman", is_linear=True),
        Filter("ekf", "gaussian"),
        Filter("ukf", "gaussian"),
        Filter("particle", "particle"),
    )
}


def usual_filter(is_affine: bool, has_events: bool = False) -> str:
    """The filter that is taken where none is named."""
    return "time-varying" if is_affine and not has_events else "ekf"
