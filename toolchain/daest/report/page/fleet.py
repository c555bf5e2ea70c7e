"""A fleet as one HTML page that loads nothing."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from typing import Any

from daest.report.console import number, percent


def fleet_page(document: Mapping[str, Any]) -> str:
    """HTML of a `FleetDocument`; every text is escaped."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(
        loader=PackageLoader("daest.report.page", "."), autoescape=True, trim_blocks=True
    )
    environment.filters["number"] = number
    environment.filters["percent"] = percent
    machines = document["machines"]
    return environment.get_template("fleet.html.jinja").render(
        document=document,
        missing=sum(machine["effect"] is not None for machine in machines),
        outputs=list(dict.fromkeys(name for machine in machines for name in machine["fit_percent"])),
        parameters=list(dict.fromkeys(name for machine in machines for name in machine["parameters"])),
        style=resources.files("daest.report.page").joinpath("style.css").read_text(encoding="utf-8"),
    )
