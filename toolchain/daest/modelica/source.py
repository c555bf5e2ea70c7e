"""The source text of a model: reading it, and the way from byte offsets to places and declarations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from daest.errors import ModelError, Place
from daest.files import why_no_file
from daest.modelica.syntax import Span
from daest.modelica.tokens import place_of

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def read_source(path: Path) -> bytes:
    """The text of a .mo file in UTF-8 without byte order mark. Raises ModelError when there is none to
    read."""
    if (why := why_no_file(path)) is not None:
        raise ModelError(
            "model-file" if path.is_dir() else "model-missing",
            f"{path} {why}",
            where=str(path),
            remedy="Name a .mo file; give folders of libraries by -L.",
        )
    try:
        text = path.read_bytes()
    except OSError as problem:
        raise ModelError(
            "model-file",
            f"{path} cannot be read: {problem.strerror}",
            where=str(path),
            remedy="Check the permissions of the file.",
        ) from None
    text = text.removeprefix(_BYTE_ORDER_MARK)
    try:
        text.decode("utf-8")
    except UnicodeDecodeError as problem:
        raise ModelError(
            "model-encoding",
            f"{path} is not UTF-8 text (byte 0x{text[problem.start]:02x})",
            where=place_of(str(path), text, problem.start),
            remedy="Save the file as UTF-8; Modelica allows no other encoding.",
        ) from None
    if not text.strip():
        raise ModelError(
            "model-empty",
            f"{path} is empty",
            where=str(path),
            remedy="Write a model into it, or name another file.",
        )
    return text


@dataclass(frozen=True)
class Sources:
    """Source number -> (file name, text)."""

    texts: Mapping[int, tuple[str, bytes]]
    _places: dict[Span, Place] = field(default_factory=dict)

    def place(self, span: Span | None) -> Place | None:
        """The place where a span begins."""
        if span is None or span.source not in self.texts:
            return None
        if span not in self._places:
            file, text = self.texts[span.source]
            self._places[span] = place_of(file, text, span.start)
        return self._places[span]

    def declaration(self, span: Span | None, identifier: str) -> Place | None:
        """The place of the identifier at the end of a declaration's span (`Real phi` -> of `phi`)."""
        if span is None or span.source not in self.texts:
            return None
        file, text = self.texts[span.source]
        start = text.rfind(identifier.encode(), span.start, span.end)
        return place_of(file, text, start if start >= 0 else span.start)
