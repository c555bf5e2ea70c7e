"""What all figures share: sizes, colours, labels, and the files that they go to.

A result goes in, a matplotlib Figure comes out. Measured is grey points, a model a line, a band 95 %; every
axis has a name and a unit.
"""

from __future__ import annotations

import itertools
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


def figure(height: float, width: float = WIDTH) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def parts(whole: Figure, heights: Sequence[float]) -> list[Any]:
    """Subfigures below each other."""
    return list(whole.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0])


def colors() -> Iterator[str]:
    """The colours of models, in their order, again and again."""
    return itertools.cycle(LINES)


def label(name: str, unit: str | None) -> str:
    return f"{name} [{unit or '1'}]"


def zero_line(ax: Axes) -> None:
    ax.axhline(0.0, color="0.8", lw=0.6, zorder=0)


def legend(ax: Axes, heading: str = "") -> None:
    """The legend above the axes at the right, where it hides nothing, and a heading at the left."""
    if heading:
        ax.set_title(heading, fontsize=9, loc="left")
    if ax.get_legend_handles_labels()[1]:
        ax.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            borderaxespad=0.1,
            ncols=4,
            frameon=False,
            fontsize=SMALL,
        )


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
