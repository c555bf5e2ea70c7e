"""The figure of profile likelihoods: a panel per parameter, with the parabola of its standard error."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from daest.model.fit import FitResult, FittedParameter, Profile
from daest.numerics.statistics import chi2
from daest.report.figures import LINES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 3
PANEL = (2.9, 2.3)  # inches
HEADROOM = 1.6  # of the threshold


def profile_figure(result: FitResult) -> Figure:
    """Drop of 2 log L from its best value over each parameter; the band is the confidence interval, which
    goes on to the edge of the panel where it is open."""
    from matplotlib.figure import Figure

    columns = min(COLUMNS, len(result.profiles))
    rows = -(-len(result.profiles) // columns)
    figure = Figure(figsize=(PANEL[0] * columns, PANEL[1] * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    parameters = {p.name: p for p in result.parameters}
    for ax, profile in zip(axes, result.profiles, strict=False):
        _draw(ax, profile, parameters[profile.name])
    for ax in axes[len(result.profiles) :]:
        ax.set_axis_off()
    return figure


def _draw(ax: Axes, profile: Profile, parameter: FittedParameter) -> None:
    ax.plot(profile.values, profile.drops, color=LINES[0], marker=".", markersize=4, linewidth=1.2)
    ax.axhline(profile.threshold, color="0.5", linewidth=0.8, linestyle="--")
    low, high = profile.values[0], profile.values[-1]
    if parameter.std_error:
        grid = np.linspace(low, high, 200)
        parabola = ((grid - parameter.value) / parameter.std_error) ** 2
        # Both curves are measured against the same threshold, that of coloured residuals too.
        scale = profile.threshold / chi2.ppf(profile.level, 1)
        ax.plot(grid, parabola * scale, color=LINES[1], linewidth=0.8, linestyle=":", label="standard error")
    ends = [edge if end is None else end for end, edge in ((profile.lower, low), (profile.upper, high))]
    ax.axvspan(ends[0], ends[1], color=LINES[0], alpha=0.12, linewidth=0.0)
    ax.axvline(parameter.value, color="0.3", linewidth=0.8)
    ax.set_ylim(0.0, HEADROOM * profile.threshold)
    ax.set_xlabel(f"{profile.name} [{parameter.unit or '1'}]", fontsize=9)
    ax.set_ylabel("2 (log L best - log L)", fontsize=8)
    ax.tick_params(labelsize=7)
    ax.locator_params(axis="x", nbins=3)
    ax.set_title(_title(profile), fontsize=9)


def _title(profile: Profile) -> str:
    level = f"{100 * profile.level:g} %"
    sides = [
        name for name, end in (("below", profile.lower_end), ("above", profile.upper_end)) if end == "open"
    ]
    return f"{level} interval" + (f", open {' and '.join(sides)}" if sides else "")
