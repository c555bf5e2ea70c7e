"""The source text of a model: reading it, the way from byte offsets to places and declarations, and which of
its classes to compile.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from daest.errors import ModelError, Place
from daest.files import why_no_file
from daest.modelica.language import failures
from daest.modelica.language.library import BYTE_ORDER_MARK
from daest.modelica.language.outline import ClassHead, class_heads, place_of, tokens
from daest.modelica.language.syntax import Span


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
    text = text.removeprefix(BYTE_ORDER_MARK)
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


def select_class(text: bytes, path: Path, wanted: str | None) -> str:
    """The full name of the model to compile.

    Without `wanted` it is the file's only complete model: among the outermost classes if there is one, else
    among those inside of packages; of several, the only one that no other class of the file uses. With
    `wanted`, the short name of a class inside of a package is enough. Raises ModelError when there is none
    or more than one.
    """
    heads = class_heads(text)
    if wanted is not None:
        return _named(heads, text, path, wanted)
    models = _candidates(heads)
    unused = [head for head in models if not _is_used(head, text)]
    for choice in (models, unused):
        if len(choice) == 1:
            return choice[0].name
    if not models:
        raise _no_model(heads, text, path)
    raise ModelError(
        "model-ambiguous",
        f"{path} holds {len(models)} models: {', '.join(head.name for head in models)}",
        where=str(path),
        remedy=f"Name the one to use: --class {(unused or models)[-1].name}.",
    )


def _candidates(heads: tuple[ClassHead, ...]) -> list[ClassHead]:
    """Complete models that lie inside of packages only: a class declared in a model is a part of that
    model."""
    outer_models = {head.name for head in heads if head.kind != "package"}
    free = [head for head in heads if head.is_model and not _lies_in(head.name, outer_models)]
    outermost = [head for head in free if head.depth == 0]
    return outermost or free


def _is_used(head: ClassHead, text: bytes) -> bool:
    """Whether the class is named anywhere but where it is defined."""
    short = head.name.rpartition(".")[2]
    before = ""
    for token in tokens(text):
        if token.text == short and token.start != head.start and before != "end":
            return True
        before = token.text
    return False


def _lies_in(name: str, outer: set[str]) -> bool:
    parts = name.split(".")
    return any(".".join(parts[:i]) in outer for i in range(1, len(parts)))


def _named(heads: tuple[ClassHead, ...], text: bytes, path: Path, wanted: str) -> str:
    matching = [head for head in heads if head.name == wanted or head.name.endswith("." + wanted)]
    exact = [head for head in matching if head.name == wanted] or matching
    if not exact:
        if not heads:
            raise _no_model(heads, text, path)
        raise failures.unknown_class(wanted, path, text)
    head = exact[0]
    if len(exact) > 1:
        raise ModelError(
            "model-ambiguous",
            f"`{wanted}` may be {' or '.join(one.name for one in exact)}",
            where=str(path),
            remedy="Give the full name.",
        )
    if not head.is_model:
        kind = f"partial {head.kind}" if head.is_partial else head.kind
        raise failures.not_a_model(head.name, kind, place_of(str(path), text, head.start))
    return head.name


def _no_model(heads: tuple[ClassHead, ...], text: bytes, path: Path) -> ModelError:
    if not heads and (fault := failures.syntax_fault(path, text)) is not None:
        return fault
    found = ", ".join(f"{'partial ' if h.is_partial else ''}{h.kind} {h.name}" for h in heads)
    return ModelError(
        "model-none",
        f"{path} holds no complete model" + (f", only {found}" if found else ""),
        where=place_of(str(path), text, heads[0].start) if heads else str(path),
        remedy="Write `model NAME … equation … end NAME;`.",
    )
