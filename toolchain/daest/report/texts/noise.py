"""The noise report as text: which equations may carry white noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import heading, indented, listed, number, rendered, table


def text(document: Mapping[str, Any], width: int = 100, color: bool = False) -> str:
    return rendered(_parts(document), width, color)


def _parts(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    singular = [value for value in document["N_singular_values"] if value]
    yield Text(
        f"{document['n_equations']} equations, {document['n_dynamic']} dynamic, index {document['index']}; "
        f"{document['n_forbidden']} equations may not carry white noise"
    )
    yield indented(f"singular values of N: {listed([number(value) for value in singular])}")
    forbidden = [e for e in document["equations"] if not e["admissible"]]
    if forbidden:
        yield heading("No white noise here")
        yield table(
            ("eq", "equation", "place", "norm", "would contain differentiated noise"),
            (
                (
                    str(e["index"]),
                    e["text"],
                    e["place"] or e["origin"] or "",
                    number(e["projection_norm"], 3),
                    listed(e["differentiated"], 4),
                )
                for e in forbidden
            ),
            text_columns=(1, 2, 4),
        )
        for advice in dict.fromkeys(e["advice"] for e in forbidden if e["advice"]):
            yield indented(advice)
    if document["annotated"]:
        yield heading("Noise of the model")
        yield table(
            ("name", "equations", "admissible"),
            (
                (a["name"], ", ".join(map(str, a["equations"])), "yes" if a["admissible"] else "NO")
                for a in document["annotated"]
            ),
            text_columns=(0, 1, 2),
        )
    yield heading("Rank decisions")
    yield table(
        ("what", "rank", "threshold", "gap"),
        (
            (d["what"], str(d["rank"]), number(d["threshold"], 2), number(d["gap"], 2) if d["gap"] else "inf")
            for d in document["decisions"]
        ),
    )
