"""The summary of a filter run as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.estimation.filters import FILTERS
from daest.report.console import as_text, heading, indented, number, percent, table


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    nis = document["nis"]
    yield Text(f"{document['kind']} filter, log-likelihood {number(document['log_likelihood'], 8)}")
    yield indented(
        f"normalised innovations squared: {number(nis['mean'])}, 95 % band {number(nis['low'])} to "
        f"{number(nis['high'])}: {'inside' if nis['inside'] else 'OUTSIDE'}"
    )
    known = FILTERS.get(document["kind"])
    if known is not None and known.is_linear:  # the gain of a nonlinear model follows its state
        steady = document["steady_after"]
        yield indented(
            f"gain steady after {number(steady)} s" if steady is not None else "the gain is never steady"
        )
    for message in document.get("messages", ()):
        yield indented(message)
    if document["compared"]:
        yield heading("Measured outputs that were not used, against their estimates")
        yield table(
            ("output", "fit %", "rms"),
            ((name, percent(c["fit_percent"]), number(c["rms"])) for name, c in document["compared"].items()),
        )
