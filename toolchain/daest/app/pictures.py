"""The plots of the page as JSON for the drawing library in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from daest.app.state import Desk, read_json
from daest.report.page.plots import (
    Plot,
    comparison_plots,
    followed_figures,
    frequency_plots,
    residual_plots,
    stacked_item,
)


def comparison_pictures(desk: Desk) -> list[dict[str, Any]]:
    """The comparison that was kept last: over time, then spectra and residual tests; none where there is
    none, or where its series are of another one."""
    results = desk.folder / "results"
    document = read_json(results / "comparison.json")
    series = _arrays(results / "comparison.npz")
    if document is None or series is None:
        return []
    try:
        plots = [
            *comparison_plots(document, series),
            *frequency_plots(document, series),
            *residual_plots(document, series),
        ]
    except (KeyError, TypeError, ValueError, IndexError):
        return []  # the document and its series are written one after the other
    return [_entry(plot) for plot in plots]


def following_pictures(told: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A figure for every output that the simulating process has told of; its sources are filled in the page
    by their names: measured, band, fit and now, each with the number of the output."""
    figures = followed_figures(told)
    names = ", ".join(output["name"] for output in told["outputs"])
    label = f"Measured and simulated {names} against time; what is simulated follows the sliders"
    return [_entry(Plot("plot-follow", label, stacked_item(figures, "time [s]")))] if figures else []


def _entry(plot: Plot) -> dict[str, Any]:
    return {"id": plot.id, "label": plot.label, "note": plot.note, "item": plot.item}


def _arrays(path: Path) -> dict[str, np.ndarray] | None:
    import zipfile

    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, ValueError, zipfile.BadZipFile):
        return None
