"""Figures: a result goes in, a matplotlib Figure comes out. Measured is grey points, a model a line, a band
95 %."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daest.model.comparison import Comparison
from daest.model.estimates import FilterResult
from daest.model.experiment import Experiment
from daest.model.linear import LinearDAE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEASURED: dict[str, Any] = {
    "color": "0.6",
    "linestyle": "none",
    "marker": ".",
    "markersize": 2.5,
    "label": "measured",
}
LINES = ("#1f5fa8", "#c2501c", "#2e7d4f", "#7b4ba0", "#a38a1a", "#5a5a5a")
BAND = 1.96  # standard deviations to either side of a 95 % band
WIDTH = 8.0  # inches
PANEL = 1.9  # inches of height per panel


def comparison_figure(comparison: Comparison) -> Figure:
    """Per output: measured and simulated values, and below them the errors. Recordings stand side by side."""
    outputs, experiments = comparison.output_names, comparison.experiments
    figure, axes = _panels(2 * len(outputs), len(experiments))
    for column, experiment in enumerate(experiments):
        for i, output in enumerate(outputs):
            values, errors = axes[2 * i][column], axes[2 * i + 1][column]
            measured = experiment.outputs[:, i]
            values.plot(experiment.time, measured, **MEASURED)
            for model, color in zip(comparison.models, _colors(), strict=False):
                fit = model.simulation.fit_percent[output]
                label = model.name if fit is None else f"{model.name} ({fit:.1f} %)"
                values.plot(experiment.time, model.simulated[column][:, i], color=color, lw=1.0, label=label)
                errors.plot(experiment.time, measured - model.simulated[column][:, i], color=color, lw=0.8)
            values.set_ylabel(_label(output, comparison.output_units[i]))
            errors.set_ylabel(_label("error", comparison.output_units[i]))
            errors.axhline(0.0, color="0.8", lw=0.6)
            values.legend(loc="upper right", fontsize=7)
        axes[0][column].set_title(experiment.name, fontsize=9)
        axes[-1][column].set_xlabel("time [s]")
    return figure


def filter_figure(result: FilterResult, experiment: Experiment, names: tuple[str, ...] = ()) -> Figure:
    """Estimates of all measured outputs, or of the variables `names`, with their 95 % bands."""
    shown = list(names) or [name for name in experiment.output_names if name in result.names]
    figure, axes = _panels(len(shown), 1)
    for row, name in enumerate(shown):
        ax = axes[row][0]
        at = result.names.index(name)
        value, std, unit = result.values[:, at], result.std[:, at], result.units[at]
        if name in experiment.output_names:
            ax.plot(experiment.time, experiment.outputs[:, experiment.output_names.index(name)], **MEASURED)
        finite = np.isfinite(std)
        low, high = np.where(finite, value - BAND * std, np.nan), np.where(finite, value + BAND * std, np.nan)
        ax.fill_between(result.time, low, high, color=LINES[0], alpha=0.25, lw=0, label="95 %")
        ax.plot(
            result.time, value, color=LINES[0], lw=1.0, label="smoothed" if result.smoothed else "filtered"
        )
        measured = [line.get_ydata() for line in ax.get_lines()[:-1]]
        ax.set_ylim(*_limits([value, *measured]))
        suffix = " (not used)" if name in result.compared else ""
        ax.set_ylabel(_label(name + suffix, unit))
        ax.legend(loc="upper right", fontsize=7)
    axes[-1][0].set_xlabel("time [s]")
    return figure


def noise_figure(dae: LinearDAE, admissible: np.ndarray, norms: np.ndarray) -> Figure:
    """Pattern of E (filled) and J (open), rows that may carry no white noise in colour, and their projection
    norms.

    `admissible` (n,) bool and `norms` (n,) belong to the equations.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 5.0), layout="constrained")
    pattern, bars = figure.subplots(1, 2, width_ratios=(2, 1), sharey=True)
    _spy(pattern, dae.J, admissible, marker="o", filled=False)
    _spy(pattern, dae.E, admissible, marker="o", filled=True)
    pattern.set_xlabel("unknown")
    pattern.set_ylabel("equation")
    pattern.set_title("E (filled), J (open)", fontsize=9)
    pattern.set_ylim(len(norms) - 0.5, -0.5)
    rows = np.arange(len(norms))
    bars.barh(rows, norms, color=np.where(admissible, "0.8", LINES[1]))
    bars.set_xlabel("projection norm [1]")
    bars.set_title("coloured: no white noise here", fontsize=9)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the figure in the format of the suffix of `path`."""
    figure.savefig(path, dpi=150)


def _panels(n_rows: int, n_columns: int) -> tuple[Figure, list[list[Axes]]]:
    from matplotlib.figure import Figure

    size = (WIDTH * max(1.0, 0.7 * n_columns), PANEL * n_rows + 0.6)
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(n_rows, n_columns, sharex="col", squeeze=False).tolist()


def _colors() -> Any:
    import itertools

    return itertools.cycle(LINES)


def _label(name: str, unit: str) -> str:
    return f"{name} [{unit or '1'}]"


def _limits(signals: list[Any]) -> tuple[float, float]:
    """A range that shows all but the most extreme 1 % at either end, with a margin: an unknown initial state
    makes the first estimates so wild that nothing else could be seen."""
    quantiles = [np.nanquantile(signal, (0.01, 0.99)) for signal in signals]
    low, high = min(q[0] for q in quantiles), max(q[1] for q in quantiles)
    margin = 0.25 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


def _spy(ax: Axes, matrix: Any, admissible: np.ndarray, *, marker: str, filled: bool) -> None:
    dense = matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix)
    rows, columns = np.nonzero(dense)
    colors = np.where(admissible[rows], "0.35", LINES[1])
    face = colors if filled else "none"
    ax.scatter(columns, rows, s=9, marker=marker, edgecolors=colors, facecolors=face, linewidths=0.6)
