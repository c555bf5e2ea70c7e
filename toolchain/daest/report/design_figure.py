"""A designed experiment: the inputs over time, and the power against the length where an effect is to be
seen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from daest.model.design import Design
from daest.report import figures as style
from daest.report.figures import LINES, PANEL, QUIET

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
        ax.set_xlabel("time [s]")
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
