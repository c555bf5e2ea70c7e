"""What an export wrote, as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import as_text, indented, listed


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    if "estimates" in document:
        yield from _estimator(document)
        return
    yield Text(f"wrote {document['path']} ({', '.join(document['platforms'])})")
    yield indented(
        f"{document['n_equations']} equations, structural index {document['index']}, "
        f"{len(document['states'])} states: {listed(document['states'])}"
    )
    for kind in ("inputs", "outputs", "noises", "parameters"):
        yield indented(f"{kind}: {listed(document[kind])}")
    messages = document["validation"]
    yield indented("validator: no message" if not messages else "validator:\n" + "\n".join(messages))


def _estimator(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    is_c = document["fmi_version"] is None
    what = "C99" if is_c else f"FMI {document['fmi_version']}, {', '.join(document['platforms'])}"
    yield Text(f"wrote the estimator of {document['model']} to {document['path']} ({what})")
    for kind in ("inputs", "outputs", "estimates"):
        yield indented(f"{kind}: {listed(document[kind])}")
    if not is_c:
        messages = document["validation"]
        yield indented("validator: no message" if not messages else "validator:\n" + "\n".join(messages))
