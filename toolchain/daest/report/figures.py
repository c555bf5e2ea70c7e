"""What all figures share: sizes, colours, labels, and the files that they go to.

A result goes in, a matplotlib Figure comes out. Measured is grey points, a model a line, a band 95 %; every
axis has a name and a unit.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

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
ALARM = LINES[1]  # what failed or is forbidden
QUIET = "0.75"  # what passed or does not count
BAND = 1.96  # standard deviations to either side of a 95 % band
WIDTH = 8.0  # inches
PANEL = 1.9  # inches of height per panel
DPI = 150
SMALL = 7  # points of legends and of long names
LINE = 0.13  # inches of height of a line of SMALL letters
LETTER = 0.058  # inches of width of a SMALL letter, on average
KEY = 8  # letters that take the room of a line and the gaps beside it in a legend
MANY_DECADES = 100.0  # ratio of the ends of a logarithmic axis beyond which powers of ten alone are numbered
CLOCKS = (
    ("d", 86400.0, 4.0),
    ("h", 3600.0, 2.0),
)  # units of long recordings, in seconds, and from how many on
CLOCK_STEPS = (1.0, 2.0, 3.0, 6.0, 12.0, 24.0, 48.0, 120.0)  # between the numbers of such an axis
MOST_NUMBERS = 8  # of such an axis
DASHES = ("-", "--", ":")  # of models of the same colour


def figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure of the usual width and the `height` in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def parts(whole: Figure, heights: Sequence[float]) -> list[Any]:
    """Subfigures below each other."""
    return list(whole.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0])


def colors() -> Iterator[str]:
    """The colours of models, in their order, again and again."""
    return itertools.cycle(LINES)


def model_lines() -> Iterator[dict[str, Any]]:
    """Colour and dashes of models, in their order: no two of the first eighteen are alike."""
    rounds = itertools.cycle(DASHES)
    return ({"color": color, "linestyle": dashes} for dashes in rounds for color in LINES)


def wrapped(name: str, width: int) -> str:
    """`name` in lines of at most `width` characters, broken behind blanks, underscores and points, and within
    a word where it is longer than a line."""
    lines = [""]
    for word in re.findall(r"[^\s_.]*[\s_.]*", name):
        if lines[-1] and len(lines[-1]) + len(word.rstrip()) > width:
            lines.append("")
        lines[-1] += word
        while len(lines[-1].rstrip()) > width:
            lines[-1:] = [lines[-1][:width], lines[-1][width:]]
    return "\n".join(line.rstrip() for line in lines)


def label(name: str, unit: str | None) -> str:
    """The name of a signal with its unit, for an axis."""
    return f"{name} [{unit or '1'}]"


def zero_line(ax: Axes) -> None:
    """A thin line at zero."""
    ax.axhline(0.0, color="0.8", lw=0.6, zorder=0)


def legend(ax: Axes, heading: str = "") -> None:
    """The legend above the axes at the right, where it hides nothing, and a heading at the left, above the
    legend where both do not fit beside each other. Long names are broken."""
    handles, labels = ax.get_legend_handles_labels()
    room = int(_width(ax) / LETTER)  # in letters
    names = [wrapped(name, max(12, room - KEY)) for name in labels]
    wide = max((len(line) + KEY for name in names for line in name.split("\n")), default=1)
    columns = max(1, min(len(names), room // wide))
    beside = columns == len(names) and columns * wide + 1.3 * len(heading) <= room
    lines = 0 if beside else max((n.count("\n") + 1 for n in names), default=0) * -(-len(names) // columns)
    if heading:
        ax.set_title(heading, fontsize=9, loc="left", pad=None if beside else 1.5 * SMALL * lines + 6)
    if not labels:
        return
    ax.legend(
        handles,
        names,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        borderaxespad=0.1,
        ncols=columns,
        frameon=False,
        fontsize=SMALL,
    )


def _width(ax: Axes) -> float:
    """Inches from one axes of a row to the next, less what labels take."""
    place, figure = ax.get_subplotspec(), ax.figure
    columns = 1 if place is None else place.get_gridspec().ncols
    return float(figure.bbox.width / figure.dpi / columns - 1.0)


def save(figure: Figure, path: Path) -> None:
    """Write the figure in the format of the suffix of `path`, without a date."""
    dated: dict[str, dict[str, Any]] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    figure.savefig(path, dpi=DPI, metadata=dated.get(path.suffix, {}))


def shown_range(value: np.ndarray, std: np.ndarray, measured: np.ndarray) -> tuple[float, float]:
    """A range for estimates (n,): that of the measurements and of the estimates that are known better than
    the estimates vary. An unknown start makes the first estimates so wild that nothing else could be seen."""
    later = value[value.size // 2 :]
    later = later[np.isfinite(later)]
    spread = float(np.ptp(later)) if later.size else 0.0
    known = np.isfinite(std) & np.isfinite(value) & (BAND * std <= max(spread, 0.0))
    chosen = np.concatenate([value[known], later, measured[np.isfinite(measured)]])
    low, high = (float(chosen.min()), float(chosen.max())) if chosen.size else (0.0, 1.0)
    margin = 0.1 * (high - low) or 1.0
    return low - margin, high + margin


def logarithmic(ax: Axes) -> None:
    """A logarithmic axis below, with few numbers that stand apart."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    ax.set_xscale("log")
    low, high = ax.get_xlim()
    steps = (1.0,) if high > MANY_DECADES * low else (1.0, 3.0)
    is_narrow = high < 10.0 * low  # than a decade: powers of ten would give one number or none
    ax.xaxis.set_major_locator(MaxNLocator(4) if is_narrow else LogLocator(subs=steps, numticks=5))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


def time_axis(ax: Axes) -> None:
    """Name and unit of an axis below that is time in seconds: hours or days where it is long."""
    from matplotlib.ticker import FuncFormatter, MultipleLocator

    low, high = ax.dataLim.intervalx
    unit, size = next(((u, s) for u, s, most in CLOCKS if high - low >= most * s), ("s", 1.0))
    ax.set_xlabel(f"time [{unit}]")
    if unit == "s" or not np.isfinite(high - low):
        return
    count = (high - low) / size
    step = next((s for s in CLOCK_STEPS if count / s <= MOST_NUMBERS), None)
    if step is not None:
        ax.xaxis.set_major_locator(MultipleLocator(step * size))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / size:g}"))
