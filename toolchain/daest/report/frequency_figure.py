"""Frequency responses and poles of a linear model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from daest.report import figures as style
from daest.report.figures import ALARM, LINES, PANEL, SMALL
from daest.systems.linear.transfer import TransferFunction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 500  # of a frequency response
BEYOND = 1.3  # decades that are drawn below the slowest and above the fastest corner
BEYOND_LAST = 1.6  # times the last tick: no pole lies on the edge of its picture
AT_REST = 1e-9  # magnitude below which a pole is at zero, relative to the fastest


def linear_figure(
    functions: Sequence[TransferFunction], poles: np.ndarray, units: Mapping[str, str]
) -> Figure:
    """Magnitude and phase of every transfer function, by output, and the poles in the complex plane. `units`
    are those of inputs and outputs by name. Shapes: poles (n_poles,) [rad/s]."""
    outputs = list(dict.fromkeys(g.output for g in functions))
    heights = [2.6 * PANEL] * bool(outputs) + [1.7 * PANEL]
    figure = style.figure(sum(heights) + 0.3, max(style.WIDTH, 3.2 * len(outputs)))
    parts = style.parts(figure, heights)
    if outputs:
        frequencies = _frequencies(functions, poles)
        axes = parts.pop(0).subplots(2, len(outputs), sharex=True, squeeze=False)
        for column, output in enumerate(outputs):
            chosen = [g for g in functions if g.output == output]
            _draw_response(chosen, frequencies, units, axes[0][column], axes[1][column])
    _draw_poles(poles, parts.pop(0).subplots())
    return figure


def _frequencies(functions: Sequence[TransferFunction], poles: np.ndarray) -> np.ndarray:
    """Angular frequencies [rad/s] around all corners."""
    roots = [poles, *(np.roots(g.num) for g in functions)]
    corners = np.abs(np.concatenate(roots))
    corners = corners[np.isfinite(corners)]
    corners = corners[corners > AT_REST * max(corners.max(initial=0.0), 1e-300)]
    low, high = (corners.min(), corners.max()) if corners.size else (1.0, 1.0)
    return np.geomspace(low / 10**BEYOND, high * 10**BEYOND, POINTS)


def _draw_response(
    functions: Sequence[TransferFunction],
    frequencies: np.ndarray,
    units: Mapping[str, str],
    magnitude: Axes,
    phase: Axes,
) -> None:
    output = functions[0].output
    hertz = frequencies / (2 * np.pi)
    for g, color in zip(functions, style.colors(), strict=False):
        response = np.array([g(1j * w) for w in frequencies])
        if not np.any(response):
            continue
        magnitude.loglog(hertz, np.abs(response), color=color, lw=1.2, label=_named(g, units))
        phase.semilogx(hertz, np.degrees(np.unwrap(np.angle(response))), color=color, lw=1.2)
    inputs = list(dict.fromkeys(units.get(g.input) or "1" for g in functions))
    per = f"/({inputs[0]})" if len(inputs) == 1 else " per unit of the input"
    magnitude.set_ylabel(f"gain [({units.get(output) or '1'}){per}]", fontsize=8)
    magnitude.grid(True, which="major", color="0.9", lw=0.6)
    phase.grid(True, color="0.9", lw=0.6)
    phase.set_ylabel("phase [deg]")
    phase.set_xlabel("frequency [Hz]")
    if magnitude.get_lines():
        magnitude.legend(loc="lower left", fontsize=SMALL)
        return
    for ax in (magnitude, phase):
        ax.set_xscale("log")
        ax.set_xlim(hertz[0], hertz[-1])
        ax.set_yticks([])
    magnitude.annotate(
        f"no input moves {output} here",
        (0.5, 0.5), xycoords="axes fraction", ha="center", va="center", fontsize=SMALL,
    )  # fmt: skip


def _named(g: TransferFunction, units: Mapping[str, str]) -> str:
    return f"{g.input} [{units.get(g.input) or '1'}] -> {g.output} [{units.get(g.output) or '1'}]"


def _draw_poles(poles: np.ndarray, ax: Axes) -> None:
    """Poles on axes that are linear around zero and logarithmic beyond: fast and slow ones in one picture."""
    from matplotlib.scale import SymmetricalLogScale

    stable = poles.real <= 0.0
    for chosen, color, name in ((stable, LINES[0], "stable or at rest"), (~stable, ALARM, "unstable")):
        if chosen.any():
            real, imaginary = poles[chosen].real, poles[chosen].imag
            ax.plot(real, imaginary, ls="none", marker="x", ms=8, mew=1.8, color=color, label=name)
    for axis, side in ((ax.xaxis, poles.real), (ax.yaxis, poles.imag)):
        smallest = _smallest(side)
        ax.set(**{f"{axis.axis_name}scale": SymmetricalLogScale(axis, linthresh=smallest)})
        first, last = (
            math.ceil(math.log10(smallest)),
            math.ceil(math.log10(np.abs(side).max(initial=smallest))),
        )
        decades = 10.0 ** np.arange(first, last + 1)
        axis.set_ticks([*-decades[::-1], 0.0, *decades])
        ax.set(**{f"{axis.axis_name}lim": (-BEYOND_LAST * decades[-1], BEYOND_LAST * decades[-1])})
    for draw in (ax.axhline, ax.axvline):
        draw(0.0, color="0.8", lw=0.6, zorder=0)
    ax.set_xlabel("real part of the poles [1/s] (both axes linear around 0, then logarithmic)")
    ax.set_ylabel("imaginary part [rad/s]")
    style.legend(ax)


def _smallest(parts: np.ndarray) -> float:
    """The smallest size that is not rounding, 1 without any."""
    sizes = np.abs(parts)
    sizes = sizes[sizes > AT_REST * max(sizes.max(initial=0.0), 1e-300)]
    return float(sizes.min()) if sizes.size else 1.0
