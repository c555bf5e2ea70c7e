"""The report as one HTML page that loads nothing."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from daest.report.console import number, percent
from daest.report.page.material import Material
from daest.report.page.plots import BORDERS, COLORS
from daest.report.page.sections import TONES, Section, headline, places

if TYPE_CHECKING:
    from jinja2 import Environment

ROOM = "daest.report.page"
JOINT = re.compile("([_.])")
QUOTED = re.compile("`([^`]*)`")


def page(material: Material, parts: Sequence[Section]) -> str:
    """HTML of the report with its `parts`. Every text of the user's is escaped; styles, scripts and plots
    stand in the page.

    Raises KeyError, TypeError or ValueError for a document that no command wrote.
    """
    from jinja2 import UndefinedError

    template = _environment().get_template("page.html.jinja")
    try:
        return template.render(
            material=material,
            headline=headline(material),
            sections=parts,
            style=_text("style.css"),
            script=_text("figures.js") + _text("page.js"),
            library=_library(),
        )
    except UndefinedError as error:
        raise KeyError(str(error)) from error


@cache
def _environment() -> Environment:
    """The templates of the room, each of them compiled once."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(loader=PackageLoader(ROOM, "."), autoescape=True, trim_blocks=True)
    environment.filters["number"] = number
    environment.filters["percent"] = percent
    environment.filters["quoted"] = _quoted
    environment.filters["breakable"] = _breakable
    environment.globals["line_colors"], environment.globals["line_dashes"] = COLORS, BORDERS
    environment.globals["places"], environment.globals["tones"] = places, TONES
    return environment


def _quoted(text: str) -> Markup:
    """The text, escaped, with what stands between backquotes as code."""
    return Markup(QUOTED.sub(r"<code>\1</code>", str(escape(text))))


def _breakable(name: str) -> Markup:
    """The name, escaped, which may be broken behind underscores and points."""
    return Markup(JOINT.sub(r"\1<wbr>", str(escape(name))))


@cache
def _library() -> str:
    """The drawing library, without the end of a script element in its texts."""
    from bokeh.resources import Resources

    return Resources(mode="inline", components=["bokeh"]).js_raw[0].replace("</script", "<\\/script")


def _text(name: str) -> str:
    return resources.files(ROOM).joinpath(name).read_text(encoding="utf-8")


def fleet_page(document: Mapping[str, Any]) -> str:
    """HTML of a `FleetDocument`; every text is escaped."""
    machines = document["machines"]
    template = _environment().get_template("fleet.html.jinja")
    return template.render(
        document=document,
        missing=sum(machine["effect"] is not None for machine in machines),
        outputs=list(dict.fromkeys(name for machine in machines for name in machine["fit_percent"])),
        parameters=list(dict.fromkeys(name for machine in machines for name in machine["parameters"])),
        style=_text("style.css"),
    )
