"""Pictures of a fit, its profile likelihoods, a filter, a simulation and a designed experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from daest.model.comparison import Comparison
from daest.model.design import Design
from daest.model.estimates import FilterResult
from daest.model.experiment import Experiment, Simulation
from daest.model.fit import FitResult, FittedParameter, Profile
from daest.model.holds import held_inputs
from daest.numerics.statistics import chi2
from daest.report import figures as style
from daest.report.comparison_figure import draw_runs, runs_height
from daest.report.figures import ALARM, BAND, LINES, MEASURED, PANEL, QUIET, SMALL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def design_figure(found: Design) -> Figure:
    """Inputs with their ranges as light fills; below, where the aim is an effect, the smallest size that is
    seen with 95 % power against the length, at the whole amplitude."""
    n_panels = len(found.limits.inputs) + (1 if found.power else 0)
    figure = style.figure(PANEL * n_panels + 0.7)
    axes = figure.subplots(n_panels, 1, squeeze=False)[:, 0]
    steps = "steps-post" if found.limits.hold == "zoh" else "default"
    for ax, one, column in zip(axes, found.limits.inputs, found.inputs.T, strict=False):
        ax.axhspan(one.low, one.high, color=QUIET, alpha=0.3, lw=0, label="range")
        ax.plot(found.limits.time, column, color=LINES[0], lw=0.8, drawstyle=steps, label="to be played")
        ax.set_ylabel(style.label(one.name, one.unit))
        style.time_axis(ax)
        style.legend(ax)
    if found.power:
        _power(axes[-1], found)
    figure.suptitle(f"the next experiment ({found.families[0].family})", fontsize=9)
    return figure


def _power(ax: Axes, found: Design) -> None:
    whole = sorted((p.length, p.smallest_size) for p in found.power if p.amplitude == 1.0)
    ax.plot([p[0] for p in whole], [p[1] for p in whole], color=LINES[0], marker="o", label="designed")
    present = None if found.present is None else found.present.smallest_size
    if present is not None:
        ax.axhline(present, color=LINES[1], ls="--", label="the present recording")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("length [s]")
    ax.set_ylabel("size that is seen")
    style.legend(ax)


COLUMNS = 3
SMALL_PANEL = (2.9, 2.3)  # inches
HEADROOM = 1.6  # of the threshold


def profile_figure(result: FitResult) -> Figure:
    """Drop of 2 log L from its best value over each parameter; the band is the confidence interval, which
    goes on to the edge of the panel where it is open."""
    from matplotlib.figure import Figure

    columns = min(COLUMNS, len(result.profiles))
    rows = -(-len(result.profiles) // columns)
    figure = Figure(figsize=(SMALL_PANEL[0] * columns, SMALL_PANEL[1] * rows), layout="constrained")
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


def filter_figure(result: FilterResult, experiment: Experiment, names: tuple[str, ...] = ()) -> Figure:
    """Estimates of all measured outputs, or of the variables `names`, with their 95 % bands."""
    shown = list(names) or [name for name in experiment.output_names if name in result.names]
    figure = style.figure(PANEL * len(shown) + 0.8)
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for ax, name in zip(axes, shown, strict=True):
        _draw_estimate(result, experiment, name, ax)
    figure.suptitle(_judged(result), fontsize=9)
    style.time_axis(axes[-1])
    return figure


def _draw_estimate(result: FilterResult, experiment: Experiment, name: str, ax: Axes) -> None:
    at = result.names.index(name)
    value, std, unit = result.values[:, at], result.std[:, at], result.units[at]
    measured = np.zeros(0)
    if name in experiment.output_names:
        measured = experiment.output(name)
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


INPUT = "0.35"


def simulation_figure(simulation: Simulation, recording: Experiment) -> Figure:
    """Inputs above, in dark grey, held or on straight lines as the simulation took them; outputs below, with
    what `recording` has measured of them."""
    names = [*simulation.input_names, *simulation.output_names]
    names = list(dict.fromkeys(names)) or list(simulation.state_names)
    figure = style.figure(0.8 * PANEL * len(names) + 0.7)
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for ax, name in zip(axes, names, strict=True):
        is_input = name in simulation.input_names
        steps = "steps-post" if is_input and held_inputs(simulation.hold, [name])[0] else "default"
        color = INPUT if is_input else LINES[0]
        if name in recording.output_names:
            ax.plot(recording.time, recording.output(name), **MEASURED)
        ax.plot(simulation.time, simulation[name], color=color, lw=1.0, drawstyle=steps, label="simulated")
        ax.set_ylabel(style.label(name, simulation.units.get(name)))
        style.zero_line(ax)
        if name in recording.output_names:
            style.legend(ax)
    noise = "with noise" if simulation.with_noise else "without noise"
    figure.suptitle(f"{simulation.model_name}, {noise} ({simulation.method})", fontsize=9)
    style.time_axis(axes[-1])
    return figure


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
