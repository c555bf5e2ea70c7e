"""The classes of a Modelica file, found without compiling it: kind, full name, partial or not.

Tokens of Modelica source text (Modelica Language Specification, chapter 2), with their byte offsets.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from daest.errors import ModelError, Place

KINDS = ("model", "block", "class", "package", "function", "record", "connector", "type", "operator")
_COMPILABLE = ("model", "block", "class")


@dataclass(frozen=True)
class ClassHead:
    """One class definition; `name` is its full name, `start` the byte offset of its identifier."""

    kind: str
    name: str
    is_partial: bool
    start: int
    depth: int

    @property
    def is_model(self) -> bool:
        return self.kind in _COMPILABLE and not self.is_partial


def within(source: bytes) -> str:
    """The package that the file says it lies within; empty when it says none."""
    words = _head(source)
    if not words or words[0].text != "within":
        return ""
    parts = []
    for token in words[1:]:
        if token.text == ";":
            break
        parts.append(token.text)
    return "".join(parts)


def _head(source: bytes, count: int = 64) -> list[Token]:
    found: list[Token] = []
    for token in tokens(source):
        found.append(token)
        if len(found) == count or token.text == ";":
            break
    return found


def class_heads(source: bytes) -> tuple[ClassHead, ...]:
    """All class definitions of the file, outer before inner. Broken text gives what can be made out."""
    found: list[ClassHead] = []
    stack = [name for name in within(source).split(".") if name]
    base = len(stack)
    words = list(tokens(source))
    for i, token in enumerate(words):
        if token.kind != "name":
            continue
        if token.text == "end" and _ends_class(words, i, stack, base):
            stack.pop()
        elif token.text in KINDS and (head := _definition(words, i, stack, base)) is not None:
            found.append(head)
            if not _is_short(words, i):
                stack.append(head.name.rpartition(".")[2])
    return tuple(found)


def _ends_class(words: list[Token], i: int, stack: list[str], base: int) -> bool:
    return len(stack) > base and i + 1 < len(words) and words[i + 1].text == stack[-1]


def _definition(words: list[Token], i: int, stack: list[str], base: int) -> ClassHead | None:
    """The class that the keyword at `i` opens; None where the keyword stands in another role (`end
    model`)."""
    at = i + 1
    if at < len(words) and words[at].text == "extends":
        at += 1
    if at >= len(words) or words[at].kind != "name" or words[at].text in KINDS:
        return None
    before = [token.text for token in words[max(0, i - 4) : i]]
    if before and before[-1] in ("end", "."):
        return None
    name = ".".join([*stack, words[at].text])
    return ClassHead(words[i].text, name, "partial" in before, words[at].start, len(stack) - base)


def _is_short(words: list[Token], i: int) -> bool:
    """`type T = Real;` and `model M = N(…)` have no `end`."""
    at = i + (3 if i + 1 < len(words) and words[i + 1].text == "extends" else 2)
    return at < len(words) and words[at].text == "="


_TOKEN = re.compile(
    rb"""
    (?P<space>\s+|//[^\n]*|/\*.*?\*/)
  | (?P<text>"(?:[^"\\]|\\.)*")
  | (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
  | (?P<name>[A-Za-z_][A-Za-z0-9_]*|'(?:[^'\\]|\\.)*')
  | (?P<symbol>\.[*/^+-]|:=|<=|>=|<>|==|[-+*/^=<>()\[\]{},;:.])
  | (?P<other>.)
    """,
    re.VERBOSE | re.DOTALL,
)

# The compiler's parser and ours recurse: text that nests or chains deeper than this is refused beforehand.
MAX_NESTING = 300
MAX_CHAIN = 900

_OPEN = (b"(", b"[", b"{")
_CLOSE = (b")", b"]", b"}")
_CHAINING = (b"+", b"-", b"*", b"/", b"^", b".+", b".-", b".*", b"./", b".^", b"if", b"and", b"or", b"not")
_RESETTING = (b",", b";")


@dataclass(frozen=True, slots=True)
class Token:
    kind: Literal["text", "number", "name", "symbol", "other"]
    text: str
    start: int
    end: int


def tokens(source: bytes, start: int = 0) -> Iterable[Token]:
    """The tokens from byte `start` on; white space and comments are left out."""
    for match in _TOKEN.finditer(source, start):
        if match.lastgroup != "space":
            text = match.group().decode("utf-8", "replace")
            yield Token(match.lastgroup, text, match.start(), match.end())  # type: ignore[arg-type]


def place_of(file: str, source: bytes, offset: int) -> Place:
    """Line and column (in characters, from 1) of a byte offset."""
    line_start = source.rfind(b"\n", 0, offset) + 1
    column = len(source[line_start:offset].decode("utf-8", "replace")) + 1
    return Place(file, source.count(b"\n", 0, offset) + 1, column)


def offset_of(source: bytes, place: Place) -> int:
    """The byte offset of a place with a line, the inverse of `place_of`."""
    lines = source.split(b"\n")
    before = lines[(place.line or 1) - 1].decode("utf-8", "replace")[: (place.column or 1) - 1]
    return sum(len(line) + 1 for line in lines[: (place.line or 1) - 1]) + len(before.encode())


def check_depth(file: str, source: bytes) -> None:
    """Raise ModelError where brackets nest, or one expression chains operators, too deeply to be read
    safely."""
    chains = [0]
    for match in _TOKEN.finditer(source):
        if match.lastgroup not in ("symbol", "name"):
            continue
        text = match.group()
        if text in _OPEN:
            chains.append(0)
        elif text in _CLOSE:
            if len(chains) > 1:
                chains.pop()
        elif text in _RESETTING:
            chains[-1] = 0
        elif text in _CHAINING:
            chains[-1] += 1
        if len(chains) > MAX_NESTING or chains[-1] > MAX_CHAIN:
            raise ModelError(
                "model-nesting",
                f"an expression nests over {MAX_NESTING} brackets or chains over {MAX_CHAIN} operators",
                where=place_of(file, source, match.start()),
                remedy="Split it over several variables, or use arrays with sum() and for-loops.",
            )
