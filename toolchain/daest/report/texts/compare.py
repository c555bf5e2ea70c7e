"""The comparison of models as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import indented, number, percent, rendered, table


def text(document: Mapping[str, Any], width: int = 100, color: bool = False) -> str:
    return rendered(_parts(document), width, color)


def _parts(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    yield Text(f"On {', '.join(document['data'])}")
    rows = (
        _row(model, output, unit)
        for output, unit in document["outputs"].items()
        for model in document["models"]
    )
    columns = ("output", "model", "parameters", "simulation fit %", "rms", "one-step fit %", "rms", "unit")
    yield table(columns, rows, text_columns=(0, 1, 7))
    for model in document["models"]:
        for remark in model["notes"]:
            yield indented(f"{model['name']}: {remark}")


def _row(model: Mapping[str, Any], output: str, unit: str) -> tuple[str, ...]:
    one_step = model["one_step"]
    return (
        output,
        model["name"],
        str(model["n_parameters"]),
        percent(model["fit_percent"].get(output)),
        number(model["rms"].get(output)),
        percent(one_step["fit_percent"].get(output)),
        number(one_step["rms"].get(output)),
        unit,
    )
