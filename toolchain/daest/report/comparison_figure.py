"""Models against recordings: values, errors, spectra, residual tests, and where a model fails."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from daest.model.comparison import Comparison, ModelTrial
from daest.report import figures as style
from daest.report.figures import ALARM, LINES, MEASURED, PANEL, QUIET, SMALL, WIDTH
from daest.report.spectra import autocorrelation, spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TESTS = {
    "whiteness": "whiteness",
    "input_independence": "independence of inputs",
    "variable_independence": "independence of variables",
    "nis": "size of the errors",
}
ROW = 0.22  # inches of height of a bar
HEADROOM = 1.1  # of an axis from zero over what is drawn in it
LEAST_P = 1e-12  # of a drawn p-value


def comparison_figure(comparison: Comparison) -> Figure:
    """Per output: measured and simulated values, and below them the errors, recordings side by side. Below
    that: spectra of the signal and the errors; where the models were tested, autocorrelation of the one-step
    errors, growth of the error with the horizon, and the p-value of every test; and the places where the
    error is larger than elsewhere."""
    n_outputs, n_runs = len(comparison.output_names), len(comparison.experiments)
    tested = any(trial.tests for trial in comparison.models)
    places = [finding for trial in comparison.models for finding in trial.where]
    columns = _columns(comparison, tested)
    heights = [2 * PANEL * n_outputs + 0.4]
    heights += [1.15 * PANEL * n_outputs + 0.3] if columns else []
    heights += [0.8 + ROW * len(_test_rows(comparison))] if tested else []
    heights += [0.7 + 0.3 * len(places)] if places else []
    figure = style.figure(sum(heights) + 0.3, WIDTH * max(1.0, 0.7 * n_runs))
    parts = style.parts(figure, heights)
    _draw_runs(comparison, parts.pop(0).subplots(2 * n_outputs, n_runs, sharex="col", squeeze=False))
    if columns:
        _draw_columns(comparison, columns, parts.pop(0))
    if tested:
        _draw_verdicts(comparison, parts.pop(0).subplots())
    if places:
        _draw_places(comparison, parts.pop(0).subplots())
    return figure


def runs_height(comparison: Comparison) -> float:
    """Height of `draw_runs` in inches."""
    return 2 * PANEL * len(comparison.output_names) + 0.4


def draw_runs(comparison: Comparison, part: Any) -> None:
    """Values and errors alone, on a (sub)figure."""
    rows, columns = 2 * len(comparison.output_names), len(comparison.experiments)
    _draw_runs(comparison, part.subplots(rows, columns, sharex="col", squeeze=False))


def _draw_runs(comparison: Comparison, axes: Any) -> None:
    for column, experiment in enumerate(comparison.experiments):
        for i, output in enumerate(comparison.output_names):
            values, errors = axes[2 * i][column], axes[2 * i + 1][column]
            measured = experiment.outputs[:, i]
            values.plot(experiment.time, measured, **MEASURED)
            for model, color in zip(comparison.models, style.colors(), strict=False):
                error = measured - model.simulated[column][:, i]
                fit = _fit_percent(measured, error)
                label = model.name if fit is None else f"{model.name} ({fit:.1f} %)"
                values.plot(experiment.time, model.simulated[column][:, i], color=color, lw=1.0, label=label)
                errors.plot(experiment.time, error, color=color, lw=0.8)
            values.set_ylabel(style.label(output, comparison.output_units[i]))
            errors.set_ylabel(style.label("error", comparison.output_units[i]))
            style.zero_line(errors)
            style.legend(values, experiment.name if i == 0 else "")
        axes[-1][column].set_xlabel("time [s]")


def _fit_percent(measured: np.ndarray, error: np.ndarray) -> float | None:
    """100 (1 - |error| / |measured - mean|) of one recording; None where nothing varies."""
    seen = np.isfinite(measured)
    spread = np.linalg.norm(measured[seen] - measured[seen].mean()) if seen.any() else 0.0
    fit = 100.0 * (1.0 - np.linalg.norm(error[seen]) / spread) if spread > 0.0 else np.nan
    return float(fit) if np.isfinite(fit) else None


def _columns(comparison: Comparison, tested: bool) -> list[Any]:
    """What is drawn beside each other, by output: spectra where the sampling allows, tests where there are
    any, the growth of errors where there are predictions over several samples."""
    experiment = comparison.experiments[0]
    measured = experiment.outputs.T
    spectral = any(spectrum(experiment.time, values) is not None for values in measured)
    ahead = any(model.growth for model in comparison.models)
    return [
        *([_draw_spectrum] if spectral else []),
        *([_draw_white] if tested else []),
        *([_draw_growth] if tested and ahead else []),
    ]


def _draw_columns(comparison: Comparison, columns: list[Any], part: Any) -> None:
    axes = part.subplots(len(comparison.output_names), len(columns), squeeze=False)
    for i in range(len(comparison.output_names)):
        for draw, ax in zip(columns, axes[i], strict=True):
            draw(comparison, i, ax, i == 0, i == len(comparison.output_names) - 1)


def _draw_spectrum(comparison: Comparison, i: int, ax: Axes, first: bool, last: bool) -> None:
    """Amplitude density of the first recording and of the errors of its simulation."""
    experiment = comparison.experiments[0]
    measured = experiment.outputs[:, i]
    found = spectrum(experiment.time, measured)
    if found is not None:
        ax.loglog(*found, color=MEASURED["color"], lw=1.6)
    for model, color in zip(comparison.models, style.colors(), strict=False):
        error = spectrum(experiment.time, measured - model.simulated[0][:, i])
        if error is not None:
            ax.loglog(*error, color=color, lw=1.0)
    ax.set_ylabel(f"{comparison.output_names[i]} [{comparison.output_units[i] or '1'}/√Hz]")
    if first:
        ax.set_title("spectra: measured (grey), errors", fontsize=9)
    if last:
        ax.set_xlabel("frequency [Hz]")


def _draw_white(comparison: Comparison, i: int, ax: Axes, first: bool, last: bool) -> None:
    steps = np.diff(comparison.experiments[0].time)
    period = float(np.median(steps)) if steps.size else 1.0
    for model, color in zip(comparison.models, style.colors(), strict=False):
        if model.residuals:
            values, band = autocorrelation([r[:, i] for r in model.residuals])
            lags = period * np.arange(1, values.size + 1)
            ax.plot(lags, values, color=color, lw=1.0, marker=".", ms=3, label=_judged(model))
            ax.axhspan(-band, band, color="0.9", lw=0)
    ax.axhline(0.0, color="0.6", lw=0.6)
    ax.set_ylabel(f"autocorrelation, {comparison.output_names[i]} [1]", fontsize=8)
    if first:
        ax.set_title("one-step errors\n(grey: 99 % band if white)", fontsize=9)
    if first and any(model.residuals for model in comparison.models):
        ax.legend(loc="upper right", fontsize=SMALL)
    if last:
        ax.set_xlabel("lag [s]")


def _draw_growth(comparison: Comparison, i: int, ax: Axes, first: bool, last: bool) -> None:
    output = comparison.output_names[i]
    for model, color in zip(comparison.models, style.colors(), strict=False):
        ahead = [(h.seconds, h.rms[output]) for h in model.growth if h.rms[output] is not None]
        if ahead:
            ax.plot(*zip(*ahead, strict=True), color=color, lw=1.0, marker=".", ms=4)
        whole = model.simulation.rms[output]
        if whole is not None:
            ax.axhline(whole, color=color, lw=0.8, ls="--")
    ax.set_xscale("log")
    _scale_errors(ax)
    ax.set_ylabel(style.label(f"rms error, {output}", comparison.output_units[i]), fontsize=8)
    if first:
        ax.set_title("error of predictions\n(dashed: whole simulation)", fontsize=9)
    if last:
        ax.set_xlabel("predicted over [s]")


def _scale_errors(ax: Axes) -> None:
    """A logarithmic axis where errors span more than a decade, else one from zero."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    drawn = np.concatenate(
        [np.asarray(line.get_ydata(), dtype=float) for line in ax.get_lines()] or [np.ones(1)]
    )
    drawn = drawn[np.isfinite(drawn) & (drawn > 0.0)]
    if not drawn.size or drawn.max() <= 10.0 * drawn.min():
        ax.set_ylim(0.0, HEADROOM * drawn.max(initial=0.0) or 1.0)
        return
    ax.set_yscale("log")
    if drawn.max() <= 200.0 * drawn.min():  # too few whole decades for a scale of them alone
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())


def _judged(model: ModelTrial) -> str:
    return model.name if model.verdict is None else f"{model.name}: {model.verdict}"


def _test_rows(comparison: Comparison) -> list[tuple[str, float, bool]]:
    """Name, p-value and outcome of every test."""
    several = len(comparison.models) > 1
    return [
        (f"{model.name}: {name}" if several else name, test.p_value, test.passed)
        for model in comparison.models
        for kind, by_output in model.tests.items()
        for output, test in by_output.items()
        for name in [f"{TESTS.get(kind, kind)}, {output}"]
    ]


def _draw_verdicts(comparison: Comparison, ax: Axes) -> None:
    """The p-value of every test: the further to the right, the less the errors look like chance."""
    rows = _test_rows(comparison)
    for place, (_, p_value, passed) in enumerate(rows):
        size = -np.log10(max(p_value, LEAST_P))
        ax.barh(place, size, color=QUIET if passed else ALARM, height=0.65)
        shown = f"p = {p_value:.2g}" if p_value >= LEAST_P else f"p < {LEAST_P:.0e}"
        text = f"{'passed' if passed else 'failed'}, {shown}"
        ax.annotate(text, (size, place), (4, 0), textcoords="offset points", va="center", fontsize=SMALL)
    ax.set_yticks(range(len(rows)), [name for name, _, _ in rows], fontsize=SMALL)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_xlim(0.0, 1.3 * max([-np.log10(max(p, LEAST_P)) for _, p, _ in rows] + [2.0]))
    ax.set_xlabel("evidence against the model, -log10 of the p-value [1]")
    ax.set_title("residual tests", fontsize=9)


def _draw_places(comparison: Comparison, ax: Axes) -> None:
    """A bar per finding: its share of the error, and a mark where it would end if the error were spread
    evenly."""
    several = len(comparison.models) > 1
    names: list[str] = []
    for model, color in zip(comparison.models, style.colors(), strict=False):
        for finding in model.where:
            row = len(names)
            ax.barh(row, 100.0 * finding.share, color=color if several else LINES[0], height=0.6)
            ax.plot([100.0 * finding.expected] * 2, [row - 0.4, row + 0.4], color="black", lw=1.6)
            prefix = f"{model.name}: " if several else ""
            names.append(prefix + finding.text.split(" % of the ", 1)[-1].rsplit(" (", 1)[0])
    ax.set_yticks(range(len(names)), names, fontsize=SMALL)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlim(0.0, 100.0)
    ax.set_xlabel("share of the error [%] (black: if it were spread evenly)")
    ax.set_title("where it fails", fontsize=9)
