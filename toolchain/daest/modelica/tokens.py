"""Tokens of Modelica source text (Modelica Language Specification, chapter 2), with their byte offsets."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from daest.errors import ModelError, Place

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
