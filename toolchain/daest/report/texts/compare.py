"""The comparison of models as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType

from daest.report.console import heading, indented, number, percent, rendered, table


def text(document: Mapping[str, Any], width: int = 100, color: bool = False) -> str:
    return rendered(_parts(document), width, color)


def _parts(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    models = document["models"]
    outputs = list(models[0]["fit_percent"])
    for title, fits, errors in (
        ("Simulation", "fit_percent", "rms"),
        ("One-step prediction", "one_step_fit_percent", "one_step_rms"),
    ):
        yield heading(f"{title} of {document['data']}")
        columns = ["model", "parameters"]
        for output in outputs:
            columns += [f"{output} fit %", "rms"]
        yield table(columns, (_row(model, outputs, fits, errors) for model in models))
    for model in models:
        for remark in model.get("notes", ()):
            yield indented(f"{model['name']}: {remark}")


def _row(model: Mapping[str, Any], outputs: list[str], fits: str, errors: str) -> list[str]:
    row = [model["name"], str(model["n_parameters"])]
    for output in outputs:
        row += [percent(model[fits].get(output)), number(model[errors].get(output))]
    return row
