"""What results have in common for notebooks: a small table as HTML or Markdown, and DataFrames and Datasets.

A value inherits from `Shown`, `Framed` or `Timed`; what stands in its tables is in `daest.model.listings`.
"""

from __future__ import annotations

import importlib
from html import escape
from typing import TYPE_CHECKING, Any

from daest.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from daest.model.listings import Listing

MOST_ROWS = 30  # of a table in a notebook; the rest is counted
EXTRA = "frames"  # optional part of the installation that brings pandas and xarray


class Shown:
    """A value that notebooks show as a table."""

    def _repr_html_(self) -> str:
        from daest.model.listings import listings_of

        return "".join(_html(listing) for listing in listings_of(self))

    def _repr_markdown_(self) -> str:
        from daest.model.listings import listings_of

        return "\n".join(_markdown(listing) for listing in listings_of(self))


class Framed(Shown):
    """A value whose first table makes a DataFrame."""

    def to_frame(self) -> pd.DataFrame:
        """The table as a pandas DataFrame over its first column. Raises ConfigError `needs-package`."""
        from daest.model.listings import listings_of

        listing = listings_of(self)[0]
        frame = _package("pandas").DataFrame(list(listing.rows), columns=list(listing.columns))
        return frame.set_index(listing.columns[0])


class Timed(Shown):
    """A value with trajectories."""

    def to_frame(self) -> pd.DataFrame:
        """A column per trajectory over the index `time` [s]; units in `attrs["units"]`. Raises ConfigError
        `needs-package`."""
        from daest.model.listings import trajectories_of

        found = trajectories_of(self)
        pandas = _package("pandas")
        frame = pandas.DataFrame(found.values, index=pandas.Index(found.time, name="time"))
        frame.attrs["units"] = dict(found.units)
        return frame

    def to_xarray(self) -> xr.Dataset:
        """A variable per trajectory over the coordinate `time` [s], with the attribute `units` where it is
        known. Raises ConfigError `needs-package`."""
        from daest.model.listings import trajectories_of

        found = trajectories_of(self)
        variables = {
            name: ("time", values, {"units": found.units[name]} if found.units.get(name) else {})
            for name, values in found.values.items()
        }
        time = {"time": ("time", found.time, {"units": "s"})}
        return _package("xarray").Dataset(variables, coords=time, attrs={"title": found.title})


def package(name: str, extra: str) -> Any:
    """An optional package. Raises ConfigError `needs-package`."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(
            "needs-package",
            f"this needs {name}, which is not installed",
            remedy=f"pip install 'daest[{extra}]'",
        ) from error


def _package(name: str) -> Any:
    return package(name, EXTRA)


def _text(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _html(listing: Listing) -> str:
    """A table with everything escaped; sizes and colours are the notebook's."""
    head = "".join(f"<th>{escape(name)}</th>" for name in listing.columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(_text(value))}</td>" for value in row) + "</tr>"
        for row in listing.rows[:MOST_ROWS]
    )
    more = f"<p>and {len(listing.rows) - MOST_ROWS} more</p>" if len(listing.rows) > MOST_ROWS else ""
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>" if listing.rows else ""
    return f"<p>{escape(listing.title)}</p>{table}{more}"


def _markdown(listing: Listing) -> str:
    def line(cells: list[str]) -> str:
        return "| " + " | ".join(_plain(cell) for cell in cells) + " |"

    lines = [_plain(listing.title), ""]
    if listing.rows:
        lines += [line(list(listing.columns)), line(["---"] * len(listing.columns))]
        lines += [line([_text(value) for value in row]) for row in listing.rows[:MOST_ROWS]]
    if len(listing.rows) > MOST_ROWS:
        lines += ["", f"and {len(listing.rows) - MOST_ROWS} more"]
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    """Text that Markdown shows as it stands, on one line."""
    marked = "".join(f"\\{c}" if c in "\\`*_[]<>|$" else c for c in text)
    return " ".join(marked.split())
