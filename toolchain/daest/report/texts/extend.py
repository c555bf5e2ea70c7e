"""What `daest extend` wrote, as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import indented, listed, rendered


def text(document: Mapping[str, Any], width: int = 100, color: bool = False) -> str:
    """The Modelica text where no file was written, else what stands in the file."""
    if document["path"] is None:
        return str(document["model"])
    parts: list[RenderableType] = [
        Text(f"wrote {document['path']}"),
        indented(f"class {document['class']}: {document['effect']} at {document['at']}"),
        indented(f"component {document['component']}, to be estimated: {listed(document['parameters'])}"),
    ]
    return rendered(parts, width, color)
