"""The plots of the page as JSON for the drawing library in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from daest.app.actions import CHECK
from daest.app.state import Desk, read_json
from daest.data.project import Project
from daest.data.read import counted_in, find_time, read_table, with_units
from daest.data.table import in_seconds
from daest.errors import DaestError
from daest.report.page.plots import (
    Drawn,
    Plot,
    comparison_plots,
    followed_figures,
    frequency_plots,
    recording_plot,
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


LARGEST_DRAWN = 100_000_000  # bytes of a recording; a longer one is not drawn before it is asked for


def recording_pictures(desk: Desk) -> list[dict[str, Any]]:
    """The recordings that were checked last, with what was found drawn on them; none where nothing was
    checked."""
    checked = desk.read(CHECK)
    try:
        project = desk.project()
        if project is None or checked is None:
            return []
        plots = [
            plot
            for number, recording in enumerate(checked["recordings"])
            for path in (*project.estimate, *project.validate)
            if path.stem == recording["name"] and path.stat().st_size <= LARGEST_DRAWN
            if (plot := _recording(number, recording, path, project)) is not None
        ]
    except (DaestError, OSError, KeyError, TypeError, ValueError):
        return []  # what is wrong with the file is told by the check itself
    return [_entry(plot) for plot in plots]


def _recording(number: int, recording: Mapping[str, Any], path: Path, project: Project) -> Plot | None:
    """Of the columns that are signals of the model, or of all of them where none is."""
    as_told = with_units(read_table(path), project.units)
    table = counted_in(recording.get("clock", "s"), as_told, project.time)
    time = in_seconds(find_time(table, project.time))
    told = [column for column in recording["columns"] if column["role"]] or recording["columns"]
    columns = []
    for about in told:
        column = table.find(about["name"])
        if column is not None:
            marks = [
                finding["time"]
                for finding in recording["findings"]
                if finding["time"] is not None and finding["column"] in (None, about["name"])
            ]
            columns.append(
                Drawn(about["name"], about["unit"] or "", about["role"] or "", column.values, marks)
            )
    return recording_plot(number, recording["name"], time, columns)


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
