"""Figures: a result goes in, a matplotlib Figure comes out. Measured is grey points, a model a line, a band
95 %."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daest.model.comparison import Comparison, ModelTrial
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
BAND_99 = 2.576  # of a 99 % band
LAGS = 40  # of a drawn autocorrelation
WIDTH = 8.0  # inches
PANEL = 1.9  # inches of height per panel


def comparison_figure(comparison: Comparison) -> Figure:
    """Per output: measured and simulated values, and below them the errors, recordings side by side. Below
    that, where the models were tested: autocorrelation of the one-step errors, growth of the error with the
    horizon, and the places where the error is larger than elsewhere."""
    from matplotlib.figure import Figure

    n_outputs, n_runs = len(comparison.output_names), len(comparison.experiments)
    tested = any(trial.tests for trial in comparison.models)
    places = [(trial, finding) for trial in comparison.models for finding in trial.where]
    heights = [2 * PANEL * n_outputs + 0.4]
    heights += [1.15 * PANEL * n_outputs] if tested else []
    heights += [0.7 + 0.3 * len(places)] if places else []
    size = (WIDTH * max(1.0, 0.7 * n_runs), sum(heights) + 0.3)
    figure = Figure(figsize=size, layout="constrained")
    parts = list(figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0])
    _draw_runs(comparison, parts.pop(0).subplots(2 * n_outputs, n_runs, sharex="col", squeeze=False))
    if tested:
        _draw_tests(comparison, parts.pop(0).subplots(n_outputs, 2, squeeze=False))
    if places:
        _draw_places(comparison, parts.pop(0).subplots())
    return figure


def _draw_runs(comparison: Comparison, axes: Any) -> None:
    for column, experiment in enumerate(comparison.experiments):
        for i, output in enumerate(comparison.output_names):
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
            errors.axhline(0.0, color="0.8", lw=0.6, zorder=0)
            values.legend(loc="upper right", fontsize=7)
        axes[0][column].set_title(experiment.name, fontsize=9)
        axes[-1][column].set_xlabel("time [s]")


def _draw_tests(comparison: Comparison, axes: Any) -> None:
    steps = np.diff(comparison.experiments[0].time)
    period = float(np.median(steps)) if steps.size else 1.0
    for i, (output, unit) in enumerate(zip(comparison.output_names, comparison.output_units, strict=True)):
        white, growth = axes[i]
        for model, color in zip(comparison.models, _colors(), strict=False):
            if model.residuals:
                values, band = _autocorrelation([r[:, i] for r in model.residuals])
                lags = period * np.arange(1, values.size + 1)
                white.plot(lags, values, color=color, lw=1.0, marker=".", ms=3, label=_judged(model))
                white.axhspan(-band, band, color="0.9", lw=0)
            ahead = [(h.seconds, h.rms[output]) for h in model.growth if h.rms[output] is not None]
            if ahead:
                growth.plot(*zip(*ahead, strict=True), color=color, lw=1.0, marker=".", ms=4)
            whole = model.simulation.rms[output]
            if whole is not None:
                growth.axhline(whole, color=color, lw=0.8, ls="--")
        white.axhline(0.0, color="0.6", lw=0.6)
        white.set_ylabel(f"autocorrelation, {output} [1]")
        white.legend(loc="upper right", fontsize=7)
        growth.set_xscale("log")
        _scale_errors(growth)
        growth.set_ylabel(_label(f"rms error, {output}", unit))
    axes[0][0].set_title("one-step errors (grey: 99 % band if white)", fontsize=9)
    axes[0][1].set_title("error of predictions (dashed: whole simulation)", fontsize=9)
    axes[-1][0].set_xlabel("lag [s]")
    axes[-1][1].set_xlabel("predicted over [s]")


def _scale_errors(ax: Axes) -> None:
    """A logarithmic axis where errors span more than a decade, else one from zero."""
    drawn = np.concatenate(
        [np.asarray(line.get_ydata(), dtype=float) for line in ax.get_lines()] or [np.ones(1)]
    )
    drawn = drawn[np.isfinite(drawn) & (drawn > 0.0)]
    if drawn.size and drawn.max() > 10.0 * drawn.min():
        ax.set_yscale("log")
    else:
        ax.set_ylim(bottom=0.0)


def _judged(model: ModelTrial) -> str:
    return model.name if model.verdict is None else f"{model.name}: {model.verdict}"


def _autocorrelation(residuals: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Autocorrelation at lags 1 … LAGS over all recordings, and half the width of its band if white."""
    known = [np.nan_to_num(r) for r in residuals]
    count = max(sum(int(np.isfinite(r).sum()) for r in residuals), 1)
    power = sum(float(r @ r) for r in known)
    lags = range(1, max(min(LAGS, count // 4), 1) + 1)
    values = [sum(float(r[lag:] @ r[:-lag]) for r in known) / power if power else 0.0 for lag in lags]
    return np.array(values), BAND_99 / float(np.sqrt(count))


def _draw_places(comparison: Comparison, ax: Axes) -> None:
    """A bar per finding: its share of the error, and a mark where it would end if the error were spread
    evenly."""
    several = len(comparison.models) > 1
    names: list[str] = []
    for model, color in zip(comparison.models, _colors(), strict=False):
        for finding in model.where:
            ax.barh(len(names), 100.0 * finding.share, color=color, height=0.6)
            ax.plot(
                [100.0 * finding.expected] * 2, [len(names) - 0.4, len(names) + 0.4], color="black", lw=1.6
            )
            prefix = f"{model.name}: " if several else ""
            names.append(prefix + finding.text.split(" % of the ", 1)[-1].rsplit(" (", 1)[0])
    ax.set_yticks(range(len(names)), names, fontsize=7)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlim(0.0, 100.0)
    ax.set_xlabel("share of the error [%] (black: if it were spread evenly)")


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
