"""Models against recordings: values, errors, spectra, residual tests, and where a model fails."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from daest.estimation.fitting.signals import fit_percent
from daest.model.comparison import Comparison, Finding
from daest.report import figures as style
from daest.report.console import LEAST_P, probability
from daest.report.figures import ALARM, LINE, LINES, MEASURED, PANEL, QUIET, SMALL, WIDTH
from daest.report.several_models import (
    DECADE,
    draw_key,
    draw_matrix,
    key_height,
    matrix_height,
    numbers,
    spread,
)
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
TEXT = 70  # characters of a line of a long label
BESIDE = 28  # characters of a line beside a panel
CLOSE = 1.15  # limit of enlarged errors, in largest errors of the models that it is for


def comparison_figure(comparison: Comparison) -> Figure:
    """Of several models first their numbers, names and errors. Per output: measured and simulated values,
    and below them the errors, recordings side by side. Below that: spectra of the signal and the errors;
    where the models were tested, autocorrelation of the one-step errors, growth of the error with the
    horizon, and the p-value of every test; and the places where the error is larger than elsewhere."""
    n_outputs, n_runs = len(comparison.output_names), len(comparison.experiments)
    several = len(comparison.models) > 1
    tested = any(trial.tests for trial in comparison.models)
    places = _places(comparison)
    columns = _columns(comparison, tested)
    tests = matrix_height(comparison) if several else 0.8 + ROW * len(_test_rows(comparison))
    heights = [key_height(comparison)] if several else []
    heights += [runs_height(comparison)]
    heights += [1.15 * PANEL * n_outputs + 0.3] if columns else []
    heights += [tests] if tested else []
    heights += [0.7 + sum(_place_heights(places))] if places else []
    figure = style.figure(sum(heights) + 0.3, WIDTH * max(1.0, 0.7 * n_runs))
    parts = style.parts(figure, heights)
    if several:
        draw_key(comparison, parts.pop(0))
    draw_runs(comparison, parts.pop(0))
    if columns:
        _draw_columns(comparison, columns, parts.pop(0))
    if tested:
        (draw_matrix if several else _draw_verdicts)(comparison, parts.pop(0).subplots())
    if places:
        _draw_places(places, parts.pop(0).subplots())
    return figure


def runs_height(comparison: Comparison) -> float:
    """Height of `draw_runs` in inches."""
    return PANEL * len(_run_rows(comparison)) + 0.4


def draw_runs(comparison: Comparison, part: Any) -> None:
    """Values and errors alone, on a (sub)figure. Where one model is much worse than the best, the errors of
    the best once more, enlarged."""
    rows, columns = _run_rows(comparison), len(comparison.experiments)
    axes = part.subplots(len(rows), columns, sharex="col", squeeze=False)
    for line, (draw, i) in zip(axes, rows, strict=True):
        for column, ax in enumerate(line):
            draw(comparison, i, column, ax)
    for ax in axes[-1]:
        style.time_axis(ax)


def _run_rows(comparison: Comparison) -> list[tuple[Any, int]]:
    """What is drawn below each other: a function and the index of an output."""
    rows: list[tuple[Any, int]] = []
    for i in range(len(comparison.output_names)):
        worst, best = spread(comparison, i)
        rows += [(_draw_values, i), (_draw_errors, i)]
        rows += [(_draw_enlarged, i)] if worst > DECADE * best else []
    return rows


def _draw_values(comparison: Comparison, i: int, column: int, ax: Axes) -> None:
    experiment = comparison.experiments[column]
    measured = experiment.outputs[:, i]
    seen = np.isfinite(measured)
    ax.plot(experiment.time, measured, **MEASURED)
    for model, name, line in zip(comparison.models, numbers(comparison), style.model_lines(), strict=False):
        simulated = model.simulated[column][:, i]
        fit = fit_percent([measured], float(np.sum((measured - simulated)[seen] ** 2)))
        label = name if fit is None else f"{name} ({_shown_percent(fit)} %)"
        ax.plot(experiment.time, simulated, lw=1.0, label=label, **line)
    label = style.label(comparison.output_names[i], comparison.output_units[i])
    ax.set_ylabel(style.wrapped(label, BESIDE))
    style.legend(ax, experiment.name if i == 0 else "")


def _shown_percent(fit: float) -> str:
    return f"{round(fit, 1) + 0.0:.1f}" if abs(fit) < 1000.0 else f"{fit:.1e}"


def _draw_errors(comparison: Comparison, i: int, column: int, ax: Axes) -> None:
    experiment = comparison.experiments[column]
    for model, line in zip(comparison.models, style.model_lines(), strict=False):
        ax.plot(experiment.time, experiment.outputs[:, i] - model.simulated[column][:, i], lw=0.8, **line)
    ax.set_ylabel(style.label("error", comparison.output_units[i]))
    style.zero_line(ax)


def _draw_enlarged(comparison: Comparison, i: int, column: int, ax: Axes) -> None:
    """Errors in the range of the models whose rms is within a decade of the best."""
    _draw_errors(comparison, i, column, ax)
    output, (_, best) = comparison.output_names[i], spread(comparison, i)
    errors = [
        np.abs(comparison.experiments[column].outputs[:, i] - model.simulated[column][:, i])
        for model in comparison.models
        if (model.simulation.rms[output] or np.inf) <= DECADE * best
    ]
    limit = CLOSE * max((float(np.nanmax(e)) for e in errors if np.isfinite(e).any()), default=best)
    ax.set_ylim(-limit, limit)
    ax.set_ylabel("enlarged\n" + style.label("error", comparison.output_units[i]))


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
    for model, line in zip(comparison.models, style.model_lines(), strict=False):
        error = spectrum(experiment.time, measured - model.simulated[0][:, i])
        if error is not None:
            ax.loglog(*error, lw=1.0, **line)
    label = f"{comparison.output_names[i]} [{comparison.output_units[i] or '1'}/√Hz]"
    ax.set_ylabel(style.wrapped(label, BESIDE), fontsize=8)
    if first:
        ax.set_title("spectra: measured (grey), errors", fontsize=9)
    if last:
        ax.set_xlabel("frequency [Hz]")


def _draw_white(comparison: Comparison, i: int, ax: Axes, first: bool, last: bool) -> None:
    steps = np.diff(comparison.experiments[0].time)
    period = float(np.median(steps)) if steps.size else 1.0
    for model, line in zip(comparison.models, style.model_lines(), strict=False):
        if model.residuals:
            values, band = autocorrelation([r[:, i] for r in model.residuals])
            lags = period * np.arange(1, values.size + 1)
            ax.plot(lags, values, lw=1.0, marker=".", ms=3, **line)
            ax.axhspan(-band, band, color="0.9", lw=0)
    ax.axhline(0.0, color="0.6", lw=0.6)
    ax.set_ylabel(style.wrapped(f"autocorrelation, {comparison.output_names[i]} [1]", BESIDE), fontsize=8)
    if first:
        ax.set_title("one-step errors\n(grey: 99 % band if white)", fontsize=9)
    if last:
        ax.set_xlabel("lag [s]")


def _draw_growth(comparison: Comparison, i: int, ax: Axes, first: bool, last: bool) -> None:
    output = comparison.output_names[i]
    for model, line in zip(comparison.models, style.model_lines(), strict=False):
        ahead = [(h.seconds, h.rms[output]) for h in model.growth if h.rms[output] is not None]
        if ahead:
            ax.plot(*zip(*ahead, strict=True), lw=1.0, marker=".", ms=4, **line)
        whole = model.simulation.rms[output]
        if whole is not None:
            ax.axhline(whole, color=line["color"], lw=0.8, ls="--")
    ax.set_xscale("log")
    _scale_errors(ax)
    label = style.label(f"rms error, {output}", comparison.output_units[i])
    ax.set_ylabel(style.wrapped(label, BESIDE), fontsize=8)
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
    if not drawn.size or drawn.max() <= DECADE * drawn.min():
        ax.set_ylim(0.0, HEADROOM * drawn.max(initial=0.0) or 1.0)
        return
    ax.set_yscale("log")
    if drawn.max() <= 200.0 * drawn.min():  # too few whole decades for a scale of them alone
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())


def _test_rows(comparison: Comparison) -> list[tuple[str, float, bool]]:
    """Name, p-value and outcome of every test."""
    return [
        (style.wrapped(f"{TESTS.get(kind, kind)}, {output}", TEXT), test.p_value, test.passed)
        for model in comparison.models
        for kind, by_output in model.tests.items()
        for output, test in by_output.items()
    ]


def _draw_verdicts(comparison: Comparison, ax: Axes) -> None:
    """The p-value of every test: the further to the right, the less the errors look like chance."""
    rows = _test_rows(comparison)
    for place, (_, p_value, passed) in enumerate(rows):
        size = -np.log10(max(p_value, LEAST_P))
        ax.barh(place, size, color=QUIET if passed else ALARM, height=0.65)
        text = f"{'passed' if passed else 'failed'}, {probability(p_value)}"
        ax.annotate(text, (size, place), (4, 0), textcoords="offset points", va="center", fontsize=SMALL)
    ax.set_yticks(range(len(rows)), [name for name, _, _ in rows], fontsize=SMALL)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_xlim(0.0, 1.3 * max([-np.log10(max(p, LEAST_P)) for _, p, _ in rows] + [2.0]))
    ax.set_xlabel("evidence against the model, -log10 of the p-value [1]")
    verdict = comparison.models[0].verdict
    ax.set_title("residual tests" if verdict is None else f"residual tests: {verdict}", fontsize=9)


def _places(comparison: Comparison) -> list[tuple[str, str, Finding]]:
    """Label, colour and finding of every place where a model fails."""
    several = len(comparison.models) > 1
    found = []
    for model, name, line in zip(comparison.models, numbers(comparison), style.model_lines(), strict=False):
        for finding in model.where:
            text = finding.text.split(" % of the ", 1)[-1].rsplit(" (", 1)[0]
            label = style.wrapped(f"{name}: {text}" if several else text, TEXT)
            found.append((label, line["color"] if several else LINES[0], finding))
    return found


def _place_heights(places: Sequence[tuple[str, str, Finding]]) -> list[float]:
    """Inches of height of every bar."""
    return [max(ROW, LINE * (label.count("\n") + 1) + 0.08) for label, _, _ in places]


def _draw_places(places: Sequence[tuple[str, str, Finding]], ax: Axes) -> None:
    """A bar per finding: its share of the error, and a mark where it would end if the error were spread
    evenly."""
    heights = np.array(_place_heights(places))
    rows = np.cumsum(heights) - 0.5 * heights
    for row, (_, color, finding) in zip(rows, places, strict=True):
        ax.barh(row, 100.0 * finding.share, color=color, height=0.65 * ROW)
        ax.plot([100.0 * finding.expected] * 2, [row - 0.4 * ROW, row + 0.4 * ROW], color="black", lw=1.6)
    ax.set_yticks(rows, [label for label, _, _ in places], fontsize=SMALL)
    ax.set_ylim(heights.sum() + 0.1 * ROW, -0.1 * ROW)
    ax.set_xlim(0.0, 100.0)
    ax.set_xlabel("share of the error [%] (black: if it were spread evenly)", fontsize=8)
    ax.set_title("where it fails", fontsize=9)
