"""An identification: parameters with their uncertainty, correlations, and the model against the data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from daest.model.comparison import Comparison
from daest.model.fit import FitResult
from daest.report import figures as style
from daest.report.comparison_figure import draw_runs, runs_height
from daest.report.figures import ALARM, BAND, LINES, SMALL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW = 0.3  # inches of height of a parameter
WRITTEN = 14  # correlations are written as numbers up to so many rows


def fit_figure(result: FitResult, comparison: Comparison | None) -> Figure:
    """The 95 % interval of every parameter in percent of its estimate and the correlations of the estimates;
    below them, measured and simulated outputs."""
    n = max(len(result.parameters), len(result.correlation_names))
    heights = [max(1.9, 0.9 + ROW * n)] + ([] if comparison is None else [runs_height(comparison)])
    figure = style.figure(sum(heights) + 0.3)
    parts = style.parts(figure, heights)
    intervals, correlations = parts[0].subplots(1, 2, width_ratios=(1.25, 1))
    _draw_intervals(result, intervals)
    _draw_correlations(result, correlations, parts[0])
    if comparison is not None:
        draw_runs(comparison, parts[1])
    return figure


def _draw_intervals(result: FitResult, ax: Axes) -> None:
    for row, p in enumerate(result.parameters):
        if p.std_error is None or p.value == 0.0:
            ax.annotate("not determined", (0.0, row), ha="center", va="center", fontsize=SMALL, color=ALARM)
            continue
        width = 100.0 * BAND * p.std_error / abs(p.value)
        ax.errorbar(
            0.0, row, xerr=width, fmt="o", color=ALARM if p.at_bound else LINES[0], ms=4, capsize=3, lw=1.6
        )
        text = f"{p.value:.5g} ± {BAND * p.std_error:.2g} {p.unit}"
        ax.annotate(text, (0.0, row), (0, 4), textcoords="offset points", ha="center", fontsize=SMALL)
    ax.axvline(0.0, color="0.85", lw=0.6, zorder=0)
    ax.set_yticks(range(len(result.parameters)), [p.name for p in result.parameters], fontsize=8)
    ax.set_ylim(len(result.parameters) - 0.4, -0.7)
    ax.set_xlabel("95 % interval around the estimate [%]")
    bounds = [p.name for p in result.parameters if p.at_bound]
    ax.set_title(f"at a bound: {', '.join(bounds)}" if bounds else "parameters, ± 95 %", fontsize=9)


def _draw_correlations(result: FitResult, ax: Axes, part: Any) -> None:
    """Blue: move together, orange: against each other. Estimates that the data do not determine are left
    out."""
    table = np.asarray(result.correlation, dtype=float)
    kept = [i for i in range(table.shape[0]) if np.isfinite(table[i]).any()]
    names = [result.correlation_names[i] for i in kept]
    shown = table[np.ix_(kept, kept)]
    from matplotlib.colors import LinearSegmentedColormap

    scale = LinearSegmentedColormap.from_list("signed", [ALARM, "white", LINES[0]])
    image = ax.imshow(shown, vmin=-1.0, vmax=1.0, cmap=scale, aspect="auto")
    ax.set_xticks(range(len(names)), names, fontsize=SMALL, rotation=60)
    ax.set_yticks(range(len(names)), names, fontsize=SMALL)
    ax.set_title("correlations [1]", fontsize=9)
    part.colorbar(image, ax=ax, ticks=(-1, 0, 1), shrink=0.8)
    if len(names) > WRITTEN:
        return
    for (i, j), value in np.ndenumerate(shown):
        if np.isfinite(value) and i != j:
            color = "white" if abs(value) > 0.6 else "black"
            written = f"{round(value, 2) + 0.0:.2f}"  # no -0.00
            ax.text(j, i, written, ha="center", va="center", fontsize=6, color=color)
