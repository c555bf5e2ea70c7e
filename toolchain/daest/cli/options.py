"""Options that several commands share, so that they are spelt and explained alike everywhere."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from daest.errors import ConfigError
from daest.model.prior import Prior

Command = TypeVar("Command", bound=Callable[..., Any])


def example(*lines: str) -> str:
    """Epilog of a command: `lines` below the word Example, each on a line of its own."""
    return "\b\nExample:\n" + "\n".join(f"  {line}" for line in lines)


def _stacked(*decorators: Callable[[Any], Any]) -> Callable[[Command], Command]:
    def apply(function: Command) -> Command:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return apply


project_option = click.option(
    "-p",
    "--project",
    "project_file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Project file (default: daest.toml here, if there is one).",
)
format_option = click.option(
    "--format",
    "form",
    type=click.Choice(["text", "json"]),
    default="text",
    help="Text for reading, or one JSON document (default: text).",
)
output_option = click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=click.Path(path_type=Path, allow_dash=True),
    help="Write the result there; - is stdout.",
)
seed_option = click.option(
    "--seed", type=click.IntRange(min=0), default=0, help="Seed of all random numbers (default: 0)."
)
class_options = _stacked(
    click.option("--class", "class_name", metavar="NAME", help="Class to use if the file holds several."),
    click.option(
        "-L",
        "--library",
        "libraries",
        metavar="DIR",
        multiple=True,
        type=click.Path(path_type=Path),
        help="Folder of Modelica libraries; MODELICAPATH is read too.",
    ),
)
set_option = click.option(
    "--set",
    "settings",
    metavar="NAME=VALUE",
    multiple=True,
    callback=lambda _ctx, _param, given: assignments(given, "--set"),
    help="Value of a parameter.",
)
plot_option = click.option(
    "--plot", metavar="FILE", type=click.Path(path_type=Path), help="Draw the result (.png, .svg or .pdf)."
)
hold_option = click.option(
    "--hold",
    type=click.Choice(["zoh", "foh"]),
    help="Inputs between samples: held, or on straight lines (default: foh).",
)
data_options = _stacked(
    click.option("--from", "start", type=float, metavar="TIME", help="Use the recording from here on [s]."),
    click.option("--to", "stop", type=float, metavar="TIME", help="Use the recording up to here [s]."),
    click.option(
        "--resample",
        "period",
        type=float,
        metavar="PERIOD",
        help="New sampling period [s], anti-alias filtered.",
    ),
    click.option(
        "--detrend",
        type=click.Choice(["none", "mean", "linear"]),
        help="Remove mean or trend of all signals.",
    ),
    hold_option,
)
split_option = click.option(
    "--split", type=float, metavar="SHARE", help="Share for estimation; the rest validates, e.g. 0.5."
)


def assignments(given: tuple[str, ...], option: str) -> dict[str, float]:
    """NAME=VALUE pairs of an option that may be repeated. Raises ConfigError `option-assignment`."""
    return dict(_assignment(text, option) for text in given)


def priors(given: tuple[str, ...]) -> dict[str, Prior]:
    """NAME=MEAN,STD of --prior, which may be repeated. Raises ConfigError `option-assignment`."""
    return dict(_prior(text) for text in given)


def _prior(text: str) -> tuple[str, Prior]:
    name, _, values = text.partition("=")
    try:
        mean, std = (float(value) for value in values.split(","))
    except ValueError:
        mean = std = math.nan
    if not name.strip() or not (math.isfinite(mean) and math.isfinite(std)):
        raise ConfigError(
            "option-assignment",
            f"--prior {text}: not of the form NAME=MEAN,STD",
            remedy="for example --prior spring.c=0.04,0.002",
        )
    return name.strip(), Prior(mean, std)


def _assignment(text: str, option: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not name.strip() or not math.isfinite(number):
        raise ConfigError(
            "option-assignment",
            f"{option} {text}: not of the form NAME=VALUE",
            remedy=f"for example {option} spring.c=0.04",
        )
    return name.strip(), number
