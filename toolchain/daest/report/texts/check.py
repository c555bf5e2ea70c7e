"""The data check as text: the columns of every recording, and what was found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import as_text, bracketed, heading, indented, number, table


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    for recording in document["recordings"]:
        yield heading(recording["name"])
        yield Text(clock_words(recording))
        yield _columns(recording["columns"])
        if not recording["findings"]:
            yield indented("nothing found")
        for finding in recording["findings"]:
            at = "" if finding["time"] is None else f" (from {finding['time']:.6g} {recording['clock']})"
            yield indented(f"{finding['level']}[{finding['code']}]: {finding['text']}{at}")


def clock_words(recording: Mapping[str, Any]) -> str:
    """How many samples at which times, `8000 samples every 0.005 s, 0 s to 39.995 s`."""
    period = recording["period"]
    clock, start, stop = recording["clock"], recording["start"], recording["stop"]
    every = "at uneven times" if period is None else f"every {period:.6g} {clock}"
    return f"{recording['n_samples']} samples {every}, {start:.6g} {clock} to {stop:.6g} {clock}"


def _columns(columns: Sequence[Mapping[str, Any]]) -> RenderableType:
    """A row for each column; roles only where a model gives them."""
    names, rows = ("column", "role", "min", "max", "step", "noise"), [_row(column) for column in columns]
    if any(column["role"] for column in columns):
        return table(names, rows, text_columns=(0, 1))
    return table((names[0], *names[2:]), ((row[0], *row[2:]) for row in rows))


def _row(column: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        f"{column['name']} {bracketed(column['unit'])}".rstrip(),
        column["role"] or "",
        number(column["min"]),
        number(column["max"]),
        number(column["resolution"], 3),
        number(column["noise_std"], 3),
    )
