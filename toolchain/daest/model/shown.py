"""What results have in common for notebooks: a small table as HTML or Markdown, and DataFrames and Datasets.

A value inherits from `Shown` or `Framed` and says in `tables` what stands in its tables; or from `Timed`, and
says in `trajectories` what it has over time.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from daest.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MOST_ROWS = 30  # of a table in a notebook; the rest is counted
EXTRA = "frames"  # optional part of the installation that brings pandas and xarray


@dataclass(frozen=True)
class Listing:
    """A table: a sentence above it, names of the columns, rows of numbers, texts, truth values or None."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Trajectories:
    """Arrays (n_samples,) by name over `time` (s), with units by name."""

    title: str
    time: np.ndarray
    values: Mapping[str, np.ndarray]
    units: Mapping[str, str]


# What prints a value of a type; `daest.report.printed` fills it, which knows the texts of the commands.
TEXTS: dict[type, Callable[[Any], str]] = {}


class Shown:
    """A value that notebooks show as a table, and that prints as the text of its command."""

    def __str__(self) -> str:
        text = TEXTS.get(type(self))
        return self._repr_markdown_().rstrip("\n") if text is None else text(self)

    def tables(self) -> tuple[Listing, ...]:
        """The tables of the value, the chief one first."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return "".join(_html(listing) for listing in self.tables())

    def _repr_markdown_(self) -> str:
        return "\n".join(_markdown(listing) for listing in self.tables())


class Framed(Shown):
    """A value whose first table makes a DataFrame."""

    def to_frame(self) -> pd.DataFrame:
        """The table as a pandas DataFrame over its first column. Raises ConfigError `needs-package`."""
        listing = self.tables()[0]
        frame = _package("pandas").DataFrame(list(listing.rows), columns=list(listing.columns))
        return frame.set_index(listing.columns[0])


class Timed(Shown):
    """A value with trajectories."""

    def trajectories(self) -> Trajectories:
        """What the value has over time."""
        raise NotImplementedError

    def tables(self) -> tuple[Listing, ...]:
        """The range of every trajectory."""
        found = self.trajectories()
        rows = tuple((name, found.units.get(name, ""), *_range(v)) for name, v in found.values.items())
        span = f"{found.time[0]:.6g} s to {found.time[-1]:.6g} s" if found.time.size else "no time"
        title = f"{found.title}: {found.time.size} samples, {span}"
        return (Listing(title, ("name", "unit", "min", "mean", "max"), rows),)

    def to_frame(self) -> pd.DataFrame:
        """A column per trajectory over the index `time` [s]; units in `attrs["units"]`. Raises ConfigError
        `needs-package`."""
        found = self.trajectories()
        pandas = _package("pandas")
        frame = pandas.DataFrame(found.values, index=pandas.Index(found.time, name="time"))
        frame.attrs["units"] = dict(found.units)
        return frame

    def to_xarray(self) -> xr.Dataset:
        """A variable per trajectory over the coordinate `time` [s], with the attribute `units` where it is
        known. Raises ConfigError `needs-package`."""
        found = self.trajectories()
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


def _range(values: np.ndarray) -> tuple[float | None, float | None, float | None]:
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.mean()), float(known.max())) if known.size else (None, None, None)


def _text(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _html(listing: Listing) -> str:
    """A table with everything escaped; sizes and colours are the notebook's."""
    from html import escape

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
