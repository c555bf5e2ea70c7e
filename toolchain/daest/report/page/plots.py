"""Interactive plots of a report. Colours of axes and text are those of the page, by its style sheet; those of
the data are seen on a light and on a dark ground."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.embed import json_item
from bokeh.layouts import gridplot
from bokeh.models import (
    BasicTickFormatter,
    BoxAnnotation,
    ColumnDataSource,
    CrosshairTool,
    FixedTicker,
    HoverTool,
    LabelSet,
    LayoutDOM,
    Range1d,
    Span,
)
from bokeh.plotting import figure

from daest.model.holds import held_inputs
from daest.report.figures import shown_range
from daest.report.groups import grouped, stretches
from daest.report.page.material import Document, Series
from daest.report.spectra import autocorrelation, spectrum


def thinned(values: np.ndarray, most: int) -> np.ndarray:
    """Indices, increasing, of at most `most` samples of `values` (n,): first and last, and the smallest and
    the largest of every stretch of equal length. All of them where they are no more than that.

    A stretch without a finite value keeps its first sample, so that a gap stays a gap.
    """
    n = values.size
    if n <= most:
        return np.arange(n)
    length = -(-n // max((most - 2) // 2, 1))  # of a stretch; the last may be shorter
    padded = np.full((-(-n // length), length), np.nan)
    padded.flat[:n] = values
    finite = np.isfinite(padded)
    first = length * np.arange(len(padded))
    smallest = first + np.argmin(np.where(finite, padded, np.inf), axis=1)
    largest = first + np.argmax(np.where(finite, padded, -np.inf), axis=1)
    return np.unique(np.concatenate([[0, n - 1], smallest, largest]))


# At least 3:1 against the ground of both schemes; told apart by the common kinds of colour blindness, and by
# dashes where lines lie on each other.
COLORS = ("#2b7fc4", "#cf5f12", "#2c8c64", "#a066c4", "#9a7b12", "#7d8590")
MEASURED = "#7d8590"
ALARM = "#cf5f12"
DASHES = ("solid", "dashed", "dotdash", "dotted", "dashdot", "solid")
BORDERS = (
    "solid",
    "dashed",
    "dashed",
    "dotted",
    "dashed",
    "solid",
)  # the dashes that HTML has
BAND = 1.96  # standard deviations to either side of a 95 % band
MOST_POINTS = 4000  # of a series
MOST_IN_ALL = 120_000  # points of all series of a kind of plot
DECADE = 10.0  # ratio of errors from which their axis is logarithmic
DETAIL, LEAST_DETAIL = 0.08, 60  # share of a recording, and samples, of the window that is shown by itself
NARROW, MIDDLE, TALL = 190, 240, 300  # px
LEVEL_LABELS = 4  # names of steps that stand level below a figure; more of them lean
LEAST_POWER = -5  # of ten, down to which a tick is written as a plain number


@dataclass(frozen=True)
class Plot:
    """A plot to embed. `label` says in words what is seen; `note` what the reader must know, as HTML-free
    text."""

    id: str
    label: str
    item: str  # JSON
    note: str = ""


def model_labels(document: Document) -> list[str]:
    """What stands for every model of a comparison in legends: its number, or its name where it is alone."""
    models = document["models"]
    return [str(i) for i in range(1, len(models) + 1)] if len(models) > 1 else [m["name"] for m in models]


def comparison_plots(
    document: Document, series: Series, labels: Sequence[str] | None = None
) -> Iterator[Plot]:
    """Per recording: measured and simulated values of every output, and below them the errors. `labels` stand
    for the models (default: `model_labels`)."""
    outputs, models = document["outputs"], list(labels or model_labels(document))
    most = _points(len(document["data"]) * len(outputs) * (1 + 2 * len(models)))
    for r, recording in enumerate(document["data"]):
        time, measured = series[f"{r}.time"], series[f"{r}.measured"]
        simulated = [series[f"{r}.{m}.simulated"] for m in range(len(models))]
        figures: list[Any] = []
        for i, (name, unit) in enumerate(outputs.items()):
            shared = figures[0].x_range if figures else None
            values = _figure("", _titled(name, unit), MIDDLE, shared)
            values.name = "compare"
            _dots(values, time, measured[:, i], "measured", most)
            errors = _figure("", _titled("error", unit), NARROW, values.x_range)
            errors.name = "compare"
            for m, model in enumerate(models):
                _line(values, time, simulated[m][:, i], model, m, most)
                _line(errors, time, measured[:, i] - simulated[m][:, i], model, m, most, legend=False)
            errors.add_layout(Span(location=0.0, dimension="width", line_color=MEASURED, line_width=1))
            _mark_windows(errors, document, name, recording)
            _legend(values)
            figures += [values, errors]
            window = telling_window(time, [measured[:, i] - one[:, i] for one in simulated])
            if window is not None:
                figures.append(
                    _detail(
                        window,
                        time,
                        measured[:, i],
                        [one[:, i] for one in simulated],
                        models,
                        _titled(name, unit),
                    )
                )
        figures[-1].xaxis.axis_label = "time [s]"
        yield Plot(
            f"plot-compare-{r}",
            f"Measured and simulated {', '.join(outputs)} of {recording} against time, errors below",
            _item(_stacked(figures)),
            _thinning_note(time.size, most),
        )


@dataclass(frozen=True)
class Drawn:
    """A column of a recording: its role (`input`, `output`, or none), values (n,) and its findings' times."""

    name: str
    unit: str
    role: str
    values: np.ndarray
    marks: Sequence[float] = ()


def recording_plot(number: int, name: str, time: np.ndarray, columns: Sequence[Drawn]) -> Plot | None:
    """The columns of a recording against its time (n,), with a line where a finding begins; None without
    columns."""
    most, figures = _points(len(columns)), list[Any]()
    known = np.isfinite(time)
    for column in columns:
        shared = figures[0].x_range if figures else None
        # A header without a unit says nothing of it; it is not 1.
        label = _titled(column.name, column.unit) if column.unit else column.name
        plot = _figure("", label, NARROW, shared)
        _dots(plot, time[known], column.values[known], column.role or "column", most)
        for mark in column.marks:
            plot.add_layout(
                Span(location=mark, dimension="height", line_color=ALARM, line_alpha=0.6, line_width=2)
            )
        _legend(plot)
        figures.append(plot)
    if not figures:
        return None
    words = f"{', '.join(column.name for column in columns)} of {name} against time"
    marked = any(column.marks for column in columns)
    return Plot(
        f"plot-recording-{number}",
        words + ("; an upright line where a fault begins" if marked else ""),
        stacked_item(figures, "time [s]"),
        _thinning_note(time.size, most),
    )


def telling_window(time: np.ndarray, errors: Sequence[np.ndarray]) -> slice | None:
    """The part of a recording where the errors of the models are largest together; None where the recording
    is so short that all of it can be read. Models count alike: each error is relative to its own size.
    Shapes: time (n_samples,) [s], errors (n_samples, n_y) each."""
    n = max(LEAST_DETAIL, int(DETAIL * time.size))
    if time.size < 2 * n:
        return None
    squares = [np.nan_to_num(error, nan=0.0) ** 2 for error in errors]
    size = sum(square / (square.mean() or 1.0) for square in squares)
    sums = np.concatenate([[0.0], np.cumsum(size)])
    start = int(np.argmax(sums[n:] - sums[:-n]))
    return slice(start, start + n)


def _detail(
    window: slice,
    time: np.ndarray,
    measured: np.ndarray,
    simulated: Sequence[np.ndarray],
    models: Sequence[str],
    label: str,
) -> Any:
    """Measured and simulated in a window, sample by sample."""
    plot = _figure("", label, MIDDLE)
    t = time[window]
    plot.title.text = f"from {t[0]:.4g} s to {t[-1]:.4g} s, where the error is largest"
    plot.title.text_font_style, plot.title.text_font_size = "normal", "12px"
    plot.title.text_color = MEASURED
    _dots(plot, t, measured[window], "measured", MOST_POINTS, size=5)
    for m, model in enumerate(models):
        _line(plot, t, simulated[m][window], model, m, MOST_POINTS)
    _legend(plot)
    return plot


def followed_figures(told: Mapping[str, Any]) -> list[Any]:
    """A figure per output that the simulating process of the live page has `told` of, still without curves:
    measured, the band and the curve of the fit, and the curve that follows the sliders. Their sources are
    called measured-N, band-N, fit-N and now-N."""
    whole, figures = told["recordings"][0], list[Any]()
    for i, output in enumerate(told["outputs"]):
        shared = figures[0].x_range if figures else Range1d(whole["start"], whole["stop"])
        plot = _figure("", _titled(output["name"], output["unit"]), MIDDLE, shared)
        plot.y_range = Range1d(-1.0, 1.0)  # the page sets it
        start = {"x": [whole["start"]], "y": [0.0]}  # an axis needs a value
        empty: dict[str, list[float]] = {"x": [], "low": [], "high": []}
        measured, fit, now = (ColumnDataSource(start, name=f"{n}-{i}") for n in ("measured", "fit", "now"))
        band = ColumnDataSource(empty, name=f"band-{i}")
        plot.varea(
            "x", "low", "high", source=band, color=COLORS[2], alpha=0.3, legend_label="95 % of the fit"
        )
        plot.line("x", "y", source=fit, color=COLORS[2], line_width=1.4, legend_label="fit")
        plot.scatter(
            "x", "y", source=measured, size=6, color=MEASURED, line_color=None, legend_label="measured"
        )
        # A layer of its own: while a slider is dragged, nothing else is painted again.
        set_ = plot.line("x", "y", source=now, color=COLORS[0], line_width=1.5, legend_label="as set")
        set_.level = "overlay"
        _legend(plot)
        figures.append(plot)
    return figures


def stacked_item(figures: Sequence[Any], x_label: str) -> str:
    """JSON of figures below each other."""
    figures[-1].xaxis.axis_label = x_label
    return _item(_stacked(figures))


def _mark_windows(plot: Any, document: Document, output: str, recording: str) -> None:
    """Stretches of time in which the error is larger than elsewhere."""
    for finding in (f for model in document["models"] for f in model["where"]):
        if finding["kind"] == "time" and finding["output"] == output and finding["data"] in (None, recording):
            box = _shade(ALARM, 0.15, left=finding["low"], right=finding["high"])
            plot.add_layout(box)


def frequency_plots(document: Document, series: Series) -> Iterator[Plot]:
    """Amplitude density of every measured output and of its simulation errors, first recording."""
    for i, (name, unit) in enumerate(document["outputs"].items()):
        time, measured = series["0.time"], series["0.measured"][:, i]
        found = spectrum(time, measured)
        if found is None:
            continue
        plot = _figure("frequency [Hz]", f"{name} [{unit or '1'}/√Hz]", TALL, None, "log", "log")
        plot.line(*found, color=MEASURED, line_width=2, legend_label="measured")
        for m, label in enumerate(model_labels(document)):
            error = spectrum(time, measured - series[f"0.{m}.simulated"][:, i])
            if error is not None:
                several = len(document["models"]) > 1
                _plain_line(plot, *error, label if several else f"error of {label}", m)
        _legend(plot)
        yield Plot(
            f"plot-frequency-{i}", f"Spectrum of {name} and of the errors of its simulation", _item(plot)
        )


def residual_plots(document: Document, series: Series) -> Iterator[Plot]:
    """Autocorrelation of the one-step errors and growth of the error with the horizon, by output."""
    recordings = range(len(document["data"]))
    period = float(np.median(np.diff(series["0.time"]))) if series["0.time"].size > 1 else 1.0
    for i, (name, unit) in enumerate(document["outputs"].items()):
        white = _figure("lag [s]", f"autocorrelation of {name} [1]", TALL)
        low, high, scale = _error_range(document, name)
        growth = _figure(
            "predicted over [s]", _titled(f"rms error of {name}", unit), TALL, None, "log", scale
        )
        growth.y_range = Range1d(low, high)
        for m, (model, label) in enumerate(zip(document["models"], model_labels(document), strict=True)):
            residuals = [
                series[f"{r}.{m}.residuals"][:, i] for r in recordings if f"{r}.{m}.residuals" in series
            ]
            if residuals:
                values, band = autocorrelation(residuals)
                _plain_line(white, period * np.arange(1, values.size + 1), values, label, m, dots=True)
                white.add_layout(_shade(MEASURED, 0.2, bottom=-band, top=band))
            ahead = [(h["seconds"], h["rms"][name]) for h in model["growth"] if h["rms"][name] is not None]
            if ahead:
                _plain_line(growth, *_columns(ahead), label, m, True)
            whole = model["rms"][name]
            if whole is not None:
                growth.add_layout(_level(whole, COLORS[m % len(COLORS)]))
        if white.renderers:
            _legend(white)
            label = f"Autocorrelation of the one-step errors of {name}; grey: 99 % band if white"
            yield Plot(f"plot-white-{i}", label, _item(white))
        if growth.renderers:
            _legend(growth)
            label = f"Error of predictions of {name} against their horizon; dashed: of the whole simulation"
            yield Plot(f"plot-growth-{i}", label, _item(growth))


def _error_range(document: Document, output: str) -> tuple[float, float, str]:
    """Range of all errors of predictions and simulations, logarithmic where they span more than a decade."""
    steps = [h["rms"][output] for model in document["models"] for h in model["growth"]]
    whole = [model["rms"][output] for model in document["models"]]
    known = [value for value in [*steps, *whole] if value is not None and value > 0.0]
    if known and max(known) > DECADE * min(known):
        return min(known) / 1.5, max(known) * 1.5, "log"
    return 0.0, 1.1 * max(known, default=1.0), "linear"


def filter_plot(document: Document, series: Series) -> Plot | None:
    """Estimates with their 95 % bands, and the measurements."""
    time, figures = series["time"], list[Any]()
    most = _points(4 * len(document["series"]))
    for i, column_ in enumerate(document["series"]):
        shared = figures[0].x_range if figures else None
        used = "" if column_["used"] or not column_["measured"] else " (not used)"
        plot = _figure("", _titled(column_["name"] + used, column_["unit"]), MIDDLE, shared)
        value, std = series["values"][:, i], series["std"][:, i]
        known = np.isfinite(std)
        low, high = (np.where(known, value + side * BAND * std, np.nan) for side in (-1, 1))
        at = np.union1d(thinned(low, most // 2), thinned(high, most // 2))
        if column_["measured"]:
            _dots(plot, time, series["measured"][:, i], "measured", most)
        plot.varea(time[at], low[at], high[at], color=COLORS[0], alpha=0.25, legend_label="95 %")
        _line(plot, time, value, "smoothed" if document["smoothed"] else "filtered", 0, most)
        plot.y_range = Range1d(*shown_range(value, std, series["measured"][:, i]))
        _legend(plot)
        figures.append(plot)
    if not figures:
        return None
    figures[-1].xaxis.axis_label = "time [s]"
    names = ", ".join(c["name"] for c in document["series"])
    return Plot(
        "plot-filter",
        f"Estimates of {names} against time with their 95 % bands",
        _item(_stacked(figures)),
        _thinning_note(time.size, most),
    )


def input_plot(document: Document, series: Series) -> Plot:
    """A designed input with its range."""
    time, figures = series["time"], list[Any]()
    headers = document["input"]["columns"][1:]
    most = _points(len(headers))
    for header, values in zip(headers, series["inputs"].T, strict=True):
        plot = _figure("", header, NARROW, figures[0].x_range if figures else None)
        low, high = document["limits"][header.partition(" [")[0]]
        for edge in (low, high):
            plot.add_layout(_level(edge, MEASURED))
        is_held = held_inputs(document["input"]["hold"], [header.partition(" [")[0]])[0]
        x, y = (np.repeat(time, 2)[1:], np.repeat(values, 2)[:-1]) if is_held else (time, values)
        _line(plot, x, y, "to be played", 0, most, legend=False)
        figures.append(plot)
    figures[-1].xaxis.axis_label = "time [s]"
    label = f"The designed input, {', '.join(headers)}, against time; lines: its range"
    return Plot("plot-experiment", label, _item(_stacked(figures)), _thinning_note(time.size, most))


def power_plot(document: Document) -> Plot | None:
    """The smallest effect that is seen with 95 % power against the length of the recording."""
    rows = [(p["length"], p["smallest_size"]) for p in document["power"] if p["amplitude"] == 1.0]
    rows = sorted(row for row in rows if row[1] is not None)
    if not rows:
        return None
    length, size = (np.array(column) for column in zip(*rows, strict=True))
    plot = _figure("length [s]", "size that is seen", TALL, x_axis="log", y_axis="log")
    _plain_line(plot, length, size, "designed", 0, dots=True)
    present = (document["present"] or {}).get("smallest_size")
    if present is not None:
        ends = np.array([length[0], length[-1]])
        _plain_line(plot, ends, np.full(2, present), "the present recordings", 1)
    _legend(plot)
    label = "Smallest effect that is seen with 95 % power, against the length"
    return Plot("plot-power", label, _item(plot))


def parameter_plot(document: Document) -> Plot | None:
    """95 % interval of every parameter, in percent of its estimate."""
    rows = [
        (name, 100.0 * BAND * p["std_error"] / abs(p["value"]))
        for name, p in document["parameters"].items()
        if p["std_error"] is not None and p["value"]
    ]
    if not rows:
        return None
    names = [name for name, _ in rows][::-1]
    widths = np.array([width for _, width in rows][::-1])
    plot = _named_bars(names, "95 % interval around the estimate [%]", 70 + 26 * len(names))
    source = ColumnDataSource({"name": names, "low": -widths, "high": widths})
    plot.hbar("name", left="low", right="high", height=0.45, color=COLORS[0], fill_alpha=0.35, source=source)
    plot.scatter(x=[0.0] * len(names), y=names, size=7, color=COLORS[0])
    plot.add_tools(HoverTool(tooltips=[("", "@name"), ("95 %", "± @high{0.000} %")]))
    label = "Uncertainty of every parameter: " + ", ".join(f"{n} ± {w:.2g} %" for n, w in rows)
    return Plot("plot-parameters", label, _item(plot))


def structure_plot(document: Document, groups: Sequence[str], columns: Sequence[str]) -> Plot:
    """Equations (rows) and unknowns (columns) by component: squares where E has an entry, dots where J has;
    rows that may not carry white noise in the colour of an alarm. `groups` and `columns` are the component of
    every row and column, in an order that keeps components together."""
    equations, structure = document["equations"], document["structure"]
    row_order, column_order = grouped(groups), grouped(columns)
    row_of = {index: place for place, index in enumerate(row_order)}
    column_of = {index: place for place, index in enumerate(column_order)}
    plot = _figure("unknowns by component", "equations by component", 640)
    plot.x_range = Range1d(-1, len(columns))
    plot.y_range = Range1d(len(groups), -1)
    allowed = [equations[index]["admissible"] for index in row_order]
    for admissible, first, after in stretches(allowed):
        if not admissible:
            plot.add_layout(_shade(ALARM, 0.16, bottom=first - 0.5, top=after - 0.5))
    names = [u["name"] for u in structure["unknowns"]]
    for key, marker, size, fill in (("J", "circle", 7, 0.0), ("E", "square", 8, 1.0)):
        for forbidden, color in ((False, COLORS[0]), (True, ALARM)):
            places = [(r, c) for r, c in structure[key] if equations[r]["admissible"] is not forbidden]
            source = ColumnDataSource(
                {
                    "x": [column_of[c] for _, c in places],
                    "y": [row_of[r] for r, _ in places],
                    "equation": [equations[r]["text"] for r, _ in places],
                    "origin": [equations[r]["origin"] for r, _ in places],
                    "unknown": [("der of " if key == "E" else "") + names[c] for _, c in places],
                    "verdict": ["no white noise here" if forbidden else "white noise may enter"]
                    * len(places),
                }
            )
            plot.scatter("x", "y", source=source, marker=marker, size=size, color=color, fill_alpha=fill)
    plot.add_tools(
        HoverTool(tooltips=[("", "@equation"), ("of", "@origin"), ("", "@unknown"), ("", "@verdict")])
    )
    _mark_groups(plot.xaxis[0], plot, [columns[i] for i in column_order], "height")
    _mark_groups(plot.yaxis[0], plot, [groups[i] for i in row_order], "width")
    plot.xaxis.major_label_orientation = 0.9
    count = sum(not e["admissible"] for e in equations)
    label = f"{len(equations)} equations and their unknowns by component; {count} may not carry white noise"
    return Plot("plot-structure", label, _item(plot))


def _mark_groups(axis: Any, plot: Any, names: Sequence[str], dimension: str) -> None:
    """The name of every group at its middle, and a line between groups."""
    runs = stretches(names)
    middles = [(first + after - 1) / 2 for _, first, after in runs]
    axis.ticker = FixedTicker(ticks=middles)
    axis.major_label_overrides = {m: run[0] for m, run in zip(middles, runs, strict=True)}
    plot.grid.visible = False
    for _, start, _ in runs[1:]:
        line = Span(location=start - 0.5, dimension=dimension, line_color=MEASURED, line_alpha=0.35)
        plot.add_layout(line)


def curve_plot(identity: str, curve: Mapping[str, Any]) -> Plot:
    """An unexplained load against the variable that explains it best."""
    x, w, std = np.array(curve["curve"], dtype=float).reshape(-1, 3).T
    where = f", where {curve['sign_of']} > 0" if curve.get("sign_of") else ""
    unit, variable_unit = curve["unit"] or "1", curve["variable_unit"] or "1"
    plot = _figure(f"{curve['variable']} [{variable_unit}]", f"unexplained load [{unit}]{where}", TALL)
    plot.add_layout(Span(location=0.0, dimension="width", line_color=MEASURED, line_width=1))
    plot.varea(x, w - BAND * std, w + BAND * std, color=COLORS[0], alpha=0.25, legend_label="95 %")
    plot.line(x, w, color=COLORS[0], line_width=2, legend_label=f"load at {curve['place']}")
    plot.scatter(x, w, color=COLORS[0], size=5)
    if (curve.get("learned") or {}).get("refitted"):
        x, w, _ = np.array(curve["learned"]["curve"], dtype=float).reshape(-1, 3).T
        plot.line(x, w, color=COLORS[1], line_width=2, legend_label="refitted in the model")
    _legend(plot)
    label = f"Unexplained load at {curve['place']} against {curve['variable']}"
    return Plot(identity, label, _item(plot))


def staircase_plots(ledger: Document) -> Iterator[Plot]:
    """Validation error of every output from step to step."""
    steps = ledger["steps"]
    names = ["as it is" if s["added"] is None else f"{i}. + {s['added']}" for i, s in enumerate(steps)]
    for i, (output, unit) in enumerate(ledger["outputs"].items()):
        errors = [step["rms"].get("validation", {}).get(output) for step in steps]
        if all(e is None for e in errors):
            continue
        plot = figure(
            x_range=names,
            height=TALL,
            sizing_mode="stretch_width",
            y_axis_label=_titled(f"rms error of {output}", unit),
            tools="save",
            toolbar_location="above",
        )
        plot.toolbar.logo = None
        heights = [np.nan if e is None else e for e in errors]
        places = ["" if s["at"] is None else f"at {s['at']}" for s in steps]
        texts = ["" if e is None else f"{e:.3g}" for e in errors]
        source = ColumnDataSource({"step": names, "error": heights, "place": places, "text": texts})
        color = COLORS[i % len(COLORS)]
        plot.vbar("step", top="error", width=0.98, color=color, fill_alpha=0.35, source=source)
        plot.add_layout(_bar_labels(source))
        plot.y_range = Range1d(0.0, 1.2 * max((e for e in errors if e is not None), default=1.0) or 1.0)
        plot.xgrid.visible = False
        plot.yaxis.formatter = _plain_ticks()
        if len(names) > LEVEL_LABELS:
            plot.xaxis.major_label_orientation = 0.5
        plot.add_tools(HoverTool(tooltips=[("", "@step @place"), ("rms", "@error")]))
        label = f"Error of {output} on validation data from step to step: " + ", ".join(texts)
        yield Plot(f"plot-staircase-{i}", label, _item(plot))


def _bar_labels(source: Any) -> Any:
    return LabelSet(
        x="step",
        y="error",
        text="text",
        source=source,
        text_align="center",
        y_offset=3,
        text_font_size="12px",
    )


def screen_plot(document: Document) -> Plot | None:
    """The highest scores of the screen, accepted candidates in colour."""
    accepted = {(c["effect"], c["at"]) for c in document["candidates"] if c["verdict"] != "rejected"}
    best: dict[tuple[str, str], float] = {}
    for entry in document["screen"]["best"]:
        best.setdefault((entry["effect"], entry["at"]), entry["score"])
    if not best:
        return None
    rows = list(best.items())[:12][::-1]
    names = [f"{effect} at {at}" for (effect, at), _ in rows]
    plot = _named_bars(names, "score [standard deviations]", 80 + 24 * len(names))
    colors = [COLORS[0] if key in accepted else MEASURED for key, _ in rows]
    source = ColumnDataSource({"name": names, "score": [score for _, score in rows], "color": colors})
    plot.hbar("name", right="score", height=0.6, color="color", fill_alpha=0.6, source=source)
    plot.x_range.start = 0
    plot.add_tools(HoverTool(tooltips=[("", "@name"), ("score", "@score{0.0}")]))
    return Plot(
        "plot-screen",
        "Scores of the screen; effects that were not rejected in colour",
        _item(plot),
    )


def _named_bars(names: Sequence[str], x_label: str, height: int) -> Any:
    """An empty figure for horizontal bars, one per name, the first at the bottom."""
    plot = figure(
        y_range=list(names),
        height=height,
        sizing_mode="stretch_width",
        x_axis_label=x_label,
        tools="save",
        toolbar_location="above",
    )
    plot.toolbar.logo = None
    return plot


def _figure(
    x_label: str,
    y_label: str,
    height: int,
    x_range: Any = None,
    x_axis: str = "linear",
    y_axis: str = "linear",
) -> Any:
    """A figure as wide as the page. Dragging zooms; the wheel scrolls the page until it is switched on."""
    options: dict[str, Any] = {} if x_range is None else {"x_range": x_range}
    plot = figure(
        height=height,
        sizing_mode="stretch_width",
        x_axis_label=x_label or None,
        y_axis_label=y_label,
        x_axis_type=x_axis,
        y_axis_type=y_axis,
        tools="xbox_zoom,xpan,xwheel_zoom,xzoom_in,xzoom_out,reset,save",
        toolbar_location="above",
        active_drag="xbox_zoom",
        active_scroll=None,
        output_backend="canvas",
        **options,
    )
    plot.toolbar.logo = None
    for axis, scale in ((plot.xaxis[0], x_axis), (plot.yaxis[0], y_axis)):
        if scale == "linear":
            axis.formatter = _plain_ticks()
    return plot


def _plain_ticks() -> Any:
    return BasicTickFormatter(power_limit_low=LEAST_POWER)


def _columns(pairs: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    table = np.array(pairs, dtype=float)
    return table[:, 0], table[:, 1]


def _level(value: float, color: str) -> Any:
    return Span(location=value, dimension="width", line_color=color, line_dash="dashed")


def _shade(color: str, alpha: float, **sides: float) -> Any:
    """A box between `sides`."""
    return BoxAnnotation(line_color=None, fill_color=color, fill_alpha=alpha, **sides)


def _dots(plot: Any, x: np.ndarray, y: np.ndarray, name: str, most: int, size: int = 3) -> None:
    at = thinned(y, most)
    dots = plot.scatter(
        x[at], y[at].astype(np.float32), size=size, color=MEASURED, legend_label=name, line_color=None
    )
    _hover(plot, dots, name)


def _line(
    plot: Any, x: np.ndarray, y: np.ndarray, name: str, number: int, most: int, legend: bool = True
) -> None:
    at = thinned(y, most)
    _plain_line(plot, x[at], y[at].astype(np.float32), name if legend else "", number)


def _plain_line(plot: Any, x: np.ndarray, y: np.ndarray, name: str, number: int, dots: bool = False) -> None:
    color, dash = COLORS[number % len(COLORS)], DASHES[number % len(DASHES)]
    named = {"legend_label": name} if name else {}
    line = plot.line(x, y, color=color, line_dash=dash, line_width=1.6, **named)
    if dots:
        plot.scatter(x, y, color=color, size=4)
    _hover(plot, line, name)


def _hover(plot: Any, drawn: Any, name: str) -> None:
    """What a curve is, and its value with its unit, where the pointer is; texts as the axes have them."""
    x, y = (_safe(axis.axis_label or "") for axis in (plot.xaxis[0], plot.yaxis[0]))
    tips = [("", _safe(name) or "error"), (x or "time [s]", "@x{%.6g}"), (y, "@y{%.5g}")]
    plot.add_tools(HoverTool(renderers=[drawn], tooltips=tips, formatters={"@x": "printf", "@y": "printf"}))


def _safe(text: str) -> str:
    """A text in a tooltip, where $ and @ would stand for values."""
    return text.replace("@", "").replace("$", "")


def _legend(plot: Any) -> None:
    """The legend above the plot, where it hides nothing."""
    for legend in list(plot.legend):
        legend.click_policy = "hide"
        legend.orientation = "horizontal"
        legend.background_fill_alpha, legend.border_line_alpha = 0.0, 0.0
        legend.padding, legend.margin, legend.label_text_font_size = 2, 0, "12px"
        plot.center.remove(legend)
        plot.add_layout(legend, "above")


def _stacked(figures: Sequence[Any]) -> Any:
    """Figures below each other with one bar of tools and one cursor."""
    cursor = Span(dimension="height", line_color=MEASURED, line_width=1)
    for plot in figures:
        plot.add_tools(CrosshairTool(overlay=cursor))
    return gridplot(
        [[plot] for plot in figures],
        sizing_mode="stretch_width",
        toolbar_location="above",
        merge_tools=True,
        toolbar_options={"logo": None},
    )


def _item(layout: LayoutDOM) -> str:
    """JSON of a layout; no text in it can end the script element that it stands in."""
    text = json.dumps(json_item(layout))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _titled(name: str, unit: str) -> str:
    return f"{name} [{unit or '1'}]"


def _points(n_series: int) -> int:
    return max(200, min(MOST_POINTS, MOST_IN_ALL // max(n_series, 1)))


def _thinning_note(n_samples: int, most: int) -> str:
    if n_samples <= most:
        return ""
    return (
        f"Of {n_samples} samples of a series at most {most} are drawn: the smallest and the largest of every "
        "stretch of equal length, so that no peak is lost."
    )
