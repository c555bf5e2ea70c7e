"""Vendor annotations `__Daest(...)` behind declarations, read from the source text.

    parameter Real c annotation (__Daest(estimate = true, scale = "log", min = 0.01, max = 1));
    input Real w annotation (__Daest(noise = true, intensity = 1e-3, estimate = true));
    output Real y annotation (__Daest(std = 0.01, estimate = false));

The compiler drops annotations, but tells where each declaration stands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Literal

from daest.errors import ModelError, Place
from daest.modelica import syntax as s
from daest.modelica.parse import ParseError, Parser
from daest.modelica.text import text
from daest.modelica.tokens import Token, place_of, tokens

Role = Literal["parameter", "input", "output", "variable"]

KEYS: dict[Role, tuple[str, ...]] = {
    # The second row is read by the catalogue of effects.
    "parameter": (
        *("estimate", "scale", "min", "max"),
        *("role", "null", "grid", "of", "from", "required", "unit"),
    ),
    "input": ("noise", "intensity", "estimate"),
    "output": ("std", "estimate"),
    "variable": (),
}
SCALES = ("auto", "linear", "log")
_OPEN, _CLOSE = ("(", "[", "{"), (")", "]", "}")


@dataclass(frozen=True)
class Annotation:
    """The entries of one `__Daest(...)`, each with its place."""

    entries: Mapping[str, s.Node] = field(default_factory=dict)
    places: Mapping[str, Place] = field(default_factory=dict)
    place: Place | None = None

    def __bool__(self) -> bool:
        return self.place is not None

    def flag(self, key: str, default: bool) -> bool:
        """A Boolean entry. Raises ModelError for any other value."""
        node = self.entries.get(key)
        if node is None:
            return default
        if not isinstance(node, s.Constant) or not isinstance(node.value, bool):
            raise self.error(key, f"`{key} = {text(node)}` must be true or false", f"Write `{key} = true`.")
        return node.value

    def scale(self) -> Literal["auto", "linear", "log"]:
        node = self.entries.get("scale")
        if node is None:
            return "auto"
        value = node.value if isinstance(node, s.Constant) else None
        for scale in SCALES:
            if value == scale:
                return scale  # type: ignore[return-value]
        raise self.error("scale", f"`scale = {text(node)}` is no scale", f"Choose {_quoted(SCALES)}.")

    def error(self, key: str, what: str, remedy: str) -> ModelError:
        return ModelError(
            "model-annotation", f"__Daest: {what}", where=self.places.get(key, self.place), remedy=remedy
        )


NONE = Annotation()


def annotation_of(file: str, source: bytes, declaration_end: int) -> Annotation:
    """The `__Daest(...)` of the declaration whose identifier ends at byte `declaration_end`; falsy if it has
    none.

    A list `Real a, b annotation(...)` gives the annotation to b alone, as Modelica does."""
    tail = _tail(source, declaration_end)
    at = _annotation_arguments(tail)
    while at is not None and at < len(tail) and tail[at].text != ")":
        if tail[at].text == "__Daest" and at + 1 < len(tail) and tail[at + 1].text == "(":
            return _entries(tail, at, file, source)
        at = _after_argument(tail, at)
    return NONE


def _tail(source: bytes, start: int) -> list[Token]:
    """The tokens of a declaration after its identifier, up to the `,` or `;` that ends it."""
    found: list[Token] = []
    depth = 0
    for token in tokens(source, start):
        if depth == 0 and token.text in (",", ";"):
            break
        depth += (token.text in _OPEN) - (token.text in _CLOSE)
        if depth < 0:
            break
        found.append(token)
    return found


def _annotation_arguments(tail: Sequence[Token]) -> int | None:
    """Index of the first token inside `annotation(...)`."""
    depth = 0
    for i, token in enumerate(tail[:-1]):
        if depth == 0 and token.text == "annotation" and tail[i + 1].text == "(":
            return i + 2
        depth += (token.text in _OPEN) - (token.text in _CLOSE)
    return None


def _after_argument(tail: Sequence[Token], at: int) -> int:
    """Index of the token after the next `,` of this bracket level, or of the closing bracket."""
    depth = 0
    while at < len(tail):
        if depth == 0 and tail[at].text in (",", ")"):
            return at + (tail[at].text == ",")
        depth += (tail[at].text in _OPEN) - (tail[at].text in _CLOSE)
        at += 1
    return at


def _entries(tail: list[Token], at: int, file: str, source: bytes) -> Annotation:
    place = place_of(file, source, tail[at].start)
    parser = Parser(tail, at + 2)
    entries: dict[str, s.Node] = {}
    places: dict[str, Place] = {}
    try:
        while parser.next is not None and parser.next.text != ")":
            key = parser.take()
            parser.take("=")
            entries[key.text] = parser.expression()
            places[key.text] = place_of(file, source, key.start)
            if parser.next is not None and parser.next.text == ",":
                parser.take()
        parser.take(")")
    except ParseError as problem:
        where = place if problem.token is None else place_of(file, source, problem.token.start)
        raise ModelError(
            "model-annotation",
            f"__Daest: {problem}",
            where=where,
            remedy="Write __Daest(key = value, …), for example __Daest(estimate = true).",
        ) from None
    return Annotation(entries, places, place)


def check_keys(annotation: Annotation, role: Role, name: str) -> None:
    """Raise ModelError for a key that has no meaning for a declaration of this role."""
    known = KEYS[role]
    for key in annotation.entries:
        if key in known:
            continue
        if not known:
            what = f"`{name}` is neither a parameter, an input nor an output"
            raise annotation.error(key, what, "Move the annotation to a parameter, an input or an output.")
        near = get_close_matches(key, known, 1)
        hint = f"Did you mean `{near[0]}`? " if near else ""
        raise annotation.error(
            key, f"`{key}` has no meaning for {role} `{name}`", f"{hint}Known there: {', '.join(known)}."
        )


def _quoted(words: Sequence[str]) -> str:
    return ", ".join(f'"{word}"' for word in words)
