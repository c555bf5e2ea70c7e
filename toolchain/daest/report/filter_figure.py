"""Estimates of a filter or a smoother with their bands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from daest.model.estimates import FilterResult
from daest.model.experiment import Experiment
from daest.report import figures as style
from daest.report.figures import BAND, LINES, MEASURED, PANEL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def filter_figure(result: FilterResult, experiment: Experiment, names: tuple[str, ...] = ()) -> Figure:
    """Estimates of all measured outputs, or of the variables `names`, with their 95 % bands."""
    shown = list(names) or [name for name in experiment.output_names if name in result.names]
    figure = style.figure(PANEL * len(shown) + 0.8)
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for ax, name in zip(axes, shown, strict=True):
        _draw_estimate(result, experiment, name, ax)
    figure.suptitle(_judged(result), fontsize=9)
    axes[-1].set_xlabel("time [s]")
    return figure


def _draw_estimate(result: FilterResult, experiment: Experiment, name: str, ax: Axes) -> None:
    at = result.names.index(name)
    value, std, unit = result.values[:, at], result.std[:, at], result.units[at]
    measured = np.zeros(0)
    if name in experiment.output_names:
        measured = experiment.outputs[:, experiment.output_names.index(name)]
        ax.plot(experiment.time, measured, **MEASURED)
    finite = np.isfinite(std)
    low, high = np.where(finite, value - BAND * std, np.nan), np.where(finite, value + BAND * std, np.nan)
    ax.fill_between(result.time, low, high, color=LINES[0], alpha=0.25, lw=0, label="95 %")
    kind = "smoothed" if result.smoothed else "filtered"
    ax.plot(result.time, value, color=LINES[0], lw=1.0, label=kind)
    ax.set_ylim(*style.shown_range(value, std, measured))
    ax.set_ylabel(style.label(name, unit))
    style.legend(ax, _agreement(result, name))


def _agreement(result: FilterResult, name: str) -> str:
    """How well an output is met that the filter has not seen."""
    found = result.compared.get(name)
    if found is None:
        return ""
    known = np.isfinite(found.fit_percent)
    return f"{name}, not used: fit {found.fit_percent:.1f} %" if known else f"{name}, not used"


def _judged(result: FilterResult) -> str:
    nis = result.nis
    verdict = "inside" if nis.inside else "outside"
    return (
        f"{result.kind} filter on {', '.join(result.measure)}; squared innovations {nis.mean:.3g}, "
        f"{verdict} {nis.low:.3g} to {nis.high:.3g}"
    )
