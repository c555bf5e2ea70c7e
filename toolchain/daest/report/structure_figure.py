"""Structure of a linear DAE: equations and unknowns by component, and where white noise may enter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from daest.model.linear import LinearDAE
from daest.model.noise import NoiseReport
from daest.report import figures as style
from daest.report.figures import ALARM, LINES, SMALL
from daest.report.groups import component, grouped, owner, stretches

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST, ROW, MOST = 4.0, 0.085, 24.0  # inches: smallest height, height of a row, largest height
NARROW = 0.011  # share of the axis below which the name of a component has no room


def noise_figure(dae: LinearDAE, report: NoiseReport) -> Figure:
    """Equations (rows) and unknowns (columns) by component: squares where E has an entry, circles where J
    has. Rows that may not carry white noise are coloured; triangles mark the equations of the model's own
    noises."""
    admissible = np.array([place.admissible for place in report.places], dtype=bool)
    rows = [component(equation.origin, equation.kind) for equation in dae.equations]
    columns = [owner(unknown.name) for unknown in dae.unknowns]
    row_of, column_of = _places(grouped(rows)), _places(grouped(columns))
    height = min(max(LEAST, ROW * dae.n), MOST)
    figure = style.figure(height + 1.2)
    ax = figure.subplots()
    for forbidden, first, after in stretches((~admissible)[grouped(rows)].tolist()):
        if forbidden:
            ax.axhspan(first - 0.5, after - 0.5, color=ALARM, alpha=0.15, lw=0)
    size = max(2.0, min(16.0, 900.0 / dae.n))
    for matrix, marker, filled in ((dae.J, "o", False), (dae.E, "s", True)):
        _spy(ax, matrix, row_of, column_of, admissible, size, marker, filled)
    _mark_noises(ax, report, row_of, dae.n)
    _name_groups(ax.yaxis, ax.axhline, [rows[i] for i in grouped(rows)])
    _name_groups(ax.xaxis, ax.axvline, [columns[i] for i in grouped(columns)])
    ax.tick_params(axis="x", rotation=60)
    ax.set_xlim(-1.0, dae.n)
    ax.set_ylim(dae.n, -1.0)
    ax.set_xlabel(f"{dae.n} unknowns, by component")
    ax.set_ylabel(f"{dae.n} equations, by component")
    forbidden = f"{report.n_forbidden} of {dae.n} equations may not carry white noise (coloured rows)"
    ax.set_title(forbidden if report.n_forbidden else "all equations may carry white noise", fontsize=9)
    _key(figure, bool(report.annotated))
    return figure


def _places(order: Sequence[int]) -> np.ndarray:
    """Place of every index in the order."""
    places = np.empty(len(order), dtype=int)
    places[list(order)] = np.arange(len(order))
    return places


def _spy(
    ax: Axes,
    matrix: Any,
    row_of: np.ndarray,
    column_of: np.ndarray,
    admissible: np.ndarray,
    size: float,
    marker: str,
    filled: bool,
) -> None:
    rows, columns = sp.csr_array(matrix).nonzero()
    colors = np.where(admissible[rows], LINES[0], ALARM)
    ax.scatter(
        column_of[columns],
        row_of[rows],
        s=size,
        marker=marker,
        edgecolors=colors,
        facecolors=colors if filled else "none",
        linewidths=0.7,
    )


def _mark_noises(ax: Axes, report: NoiseReport, row_of: np.ndarray, n: int) -> None:
    for place in (*report.annotated, *report.asked):
        for row in place.equations:
            color = LINES[2] if place.admissible else ALARM
            ax.plot(n - 0.2, row_of[row], marker="<", color=color, ms=6, clip_on=False)


def _name_groups(axis: Any, line: Any, names: Sequence[str]) -> None:
    """The name of every group at its middle, as far as there is room, and a line between groups."""
    ticks, shown = [], []
    last = -np.inf
    for name, first, after in stretches(names):
        middle = (first + after - 1) / 2
        if first:
            line(first - 0.5, color="0.85", lw=0.5, zorder=0)
        if middle - last >= NARROW * len(names):
            ticks.append(middle)
            shown.append(name)
            last = middle
    axis.set_ticks(ticks, shown, fontsize=SMALL)


def _key(figure: Figure, noises: bool) -> None:
    from matplotlib.lines import Line2D

    entries = [
        Line2D([], [], ls="none", marker="s", color=LINES[0], ms=5, label="derivative of the unknown (E)"),
        Line2D([], [], ls="none", marker="o", mfc="none", color=LINES[0], ms=5, label="unknown (J)"),
    ]
    if noises:
        entries.append(
            Line2D([], [], ls="none", marker="<", color=LINES[2], ms=5, label="white noise of the model")
        )
    figure.legend(handles=entries, loc="outside lower center", ncols=3, fontsize=SMALL)
