"""The pictures of commands: the option --plot and what it writes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daest.cli.output import whole_file
from daest.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")


def checked(_ctx: click.Context, parameter: click.Parameter, given: Path | None) -> Path | None:
    """The file of a picture. Raises ConfigError `plot-format` before anything is computed."""
    if given is None or given.suffix.lower() in FORMATS:
        return given
    raise ConfigError(
        "plot-format",
        f"{parameter.opts[-1]} {given}: no picture is written as '{given.suffix or given.name}'",
        remedy=f"give a name that ends in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}",
    )


def draw(plot: Path | None, make: Callable[[], Figure]) -> None:
    """Write the figure that `make` returns, in the format of the suffix, where a picture was asked for."""
    if plot is None:
        return
    from daest.report.figures import save

    figure = make()
    with whole_file(plot) as temporary:
        save(figure, temporary)
