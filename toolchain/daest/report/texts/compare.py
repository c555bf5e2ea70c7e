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
    for title, part in (("Simulation", None), ("One-step prediction", "one_step")):
        yield heading(f"{title} of {', '.join(document['data'])}")
        columns = ["model", "parameters"]
        for output, unit in document["outputs"].items():
            columns += [f"{output} fit %", f"rms [{unit or '1'}]"]
        outputs = list(document["outputs"])
        yield table(columns, (_row(model, part, outputs) for model in models))
    for model in models:
        for remark in model["notes"]:
            yield indented(f"{model['name']}: {remark}")


def _row(model: Mapping[str, Any], part: str | None, outputs: list[str]) -> list[str]:
    agreement = model if part is None else model[part]
    row = [model["name"], str(model["n_parameters"])]
    for output in outputs:
        row += [percent(agreement["fit_percent"].get(output)), number(agreement["rms"].get(output))]
    return row
