"""The classes of a Modelica file, found without compiling it: kind, full name, partial or not; and the text
of one class: its tokens, what it extends, its connect clauses.

Tokens of Modelica source text (Modelica Language Specification, chapter 2), with their byte offsets.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import takewhile
from typing import Literal

from daest.errors import ModelError, Place

KINDS = ("model", "block", "class", "package", "function", "record", "connector", "type", "operator")
_COMPILABLE = ("model", "block", "class")


@dataclass(frozen=True)
class ClassHead:
    """One class definition. `name` is its full name, `start` the byte offset of its identifier, `end` that of
    its word `end`; a short one, `type T = Real;`, ends at its semicolon."""

    kind: str
    name: str
    is_partial: bool
    is_short: bool
    depth: int
    start: int
    end: int

    @property
    def is_model(self) -> bool:
        return self.kind in _COMPILABLE and not self.is_partial


def within(source: bytes) -> str:
    """The package that the file says it lies within; empty when it says none."""
    words = takewhile(lambda token: token.text != ";", tokens(source))
    first = next(words, None)
    return "".join(token.text for token in words) if first is not None and first.text == "within" else ""


@lru_cache(maxsize=32)  # the steps of a compilation ask one after the other
def class_heads(source: bytes) -> tuple[ClassHead, ...]:
    """All class definitions of the file, outer before inner. Broken text gives what can be made out."""
    found: list[ClassHead] = []
    package = within(source)
    opened: list[int] = []  # indices in `found` of the classes around
    words = list(tokens(source))
    for i, token in enumerate(words):
        if token.kind != "name":
            continue
        around = found[opened[-1]].name if opened else package
        if token.text == "end" and opened and _follows(words, i, around.rpartition(".")[2]):
            at = opened.pop()
            found[at] = replace(found[at], end=token.start)
        elif token.text in KINDS and (head := _definition(words, i, around, len(opened))) is not None:
            if not head.is_short:
                opened.append(len(found))
            found.append(head)
    return tuple(found)


def _follows(words: Sequence[Token], i: int, text: str) -> bool:
    return i + 1 < len(words) and words[i + 1].text == text


def _definition(words: Sequence[Token], i: int, around: str, depth: int) -> ClassHead | None:
    """The class that the keyword at `i` opens in the class `around`; None where the keyword stands in another
    role (`end model`). A long one ends with the words until its `end` is read."""
    at = i + 1
    if at < len(words) and words[at].text == "extends":
        at += 1
    if at >= len(words) or words[at].kind != "name" or words[at].text in KINDS:
        return None
    before = [token.text for token in words[max(0, i - 4) : i]]
    if before and before[-1] in ("end", "."):
        return None
    name = f"{around}.{words[at].text}" if around else words[at].text
    is_short = _follows(words, at, "=")
    stop = find_outside(words, at, ";") if is_short else len(words)
    end = words[stop].start if stop < len(words) else words[-1].end
    return ClassHead(words[i].text, name, "partial" in before, is_short, depth, words[at].start, end)


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

# Strings and comments.
NO_CODE = re.compile(rb'"(?:[^"\\]|\\.)*"|//[^\n]*|/\*.*?\*/', re.DOTALL)

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


_INSERTED, _INSERTED_END = "/*daest<*/", "/*>daest*/"
_MARK = re.compile(rb"/\*(?:daest(<)|>daest)\*/")


def inserted(text: str) -> str:
    """Text without a line end for the compiler to read where the user wrote none: places do not count it."""
    return f"{_INSERTED}{text}{_INSERTED_END}"


def place_of(file: str, source: bytes, offset: int) -> Place:
    """Line and column (in characters, from 1) of a byte offset; what is `inserted` before does not count."""
    line_start = source.rfind(b"\n", 0, offset) + 1
    before = _without_inserted(source[line_start:offset]).decode("utf-8", "replace")
    return Place(file, source.count(b"\n", 0, offset) + 1, len(before) + 1)


def _without_inserted(line: bytes) -> bytes:
    """The part of a line without what is inserted in it, which may hold other such."""
    kept, at, depth = [], 0, 0
    for mark in _MARK.finditer(line):
        if depth == 0:
            kept.append(line[at : mark.start()])
        depth += 1 if mark[1] else -1
        at = mark.end()
    return b"".join(kept) if depth else b"".join([*kept, line[at:]])


def place_told(file: str, source: bytes, line: int, column: int) -> Place:
    """The place where the compiler, which reads all of `source`, says line and column."""
    return place_of(file, source, offset_of(source, Place(file, line, column)))


def offset_of(source: bytes, place: Place) -> int:
    """The byte offset of a place with a line, the inverse of `place_of`."""
    lines = source.split(b"\n")
    before = lines[(place.line or 1) - 1].decode("utf-8", "replace")[: (place.column or 1) - 1]
    return sum(len(line) + 1 for line in lines[: (place.line or 1) - 1]) + len(before.encode())


@dataclass(frozen=True)
class Edit:
    """Bytes from `start` to `end` that become `text`."""

    start: int
    end: int
    text: str


def laid_over(old: bytes, new: bytes = b"") -> bytes:
    """`new` and then spaces in the place of all bytes of `old` but its line ends: nothing behind it moves."""
    rest = iter(new)
    return bytes(byte if byte in b"\r\n" else next(rest, ord(" ")) for byte in old)


def edited(source: bytes, edits: Iterable[Edit]) -> bytes:
    """The text with edits that do not overlap."""
    for edit in sorted(edits, key=lambda e: (e.start, e.end), reverse=True):
        source = source[: edit.start] + edit.text.encode() + source[edit.end :]
    return source


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


OPEN, CLOSE = ("(", "[", "{"), (")", "]", "}")


@dataclass(frozen=True)
class Extends:
    """An extends clause: the name of the base as written, the connections that it removes, and first and last
    byte of the expressions that it binds variables to."""

    base: str
    broken: tuple[frozenset[str], ...]
    start: int
    bound: dict[str, tuple[int, int]]


@dataclass(frozen=True)
class ConnectClause:
    """`connect(left, right)` from byte `start` to behind its semicolon; the names without white space."""

    left: str
    right: str
    start: int
    end: int

    @property
    def pair(self) -> frozenset[str]:
        return frozenset((self.left, self.right))


def class_tokens(source: bytes, head: ClassHead) -> list[Token]:
    """The tokens of a class from its name to its `end`, without those of classes inside of it that have an
    `end` of their own; of a short class, `model M = N(…)`, to its semicolon."""
    inner = {
        one.start: one.end
        for one in class_heads(source)
        if one.name.startswith(head.name + ".") and not one.is_short
    }
    found: list[Token] = []
    words = iter(tokens(source, head.start))
    for word in words:
        if word.start >= head.end:
            break
        if word.start in inner:
            next((one for one in words if one.start >= inner[word.start]), None)
            next(words, None)  # the name behind its `end`
        else:
            found.append(word)
    return found


def find_outside(words: Sequence[Token], at: int, *stops: str) -> int:
    """Index of the first of the words `stops` from `at` on that stands outside of brackets, or of the bracket
    that closes one around; the number of words where there is neither."""
    while at < len(words) and words[at].text not in (*stops, *CLOSE):
        at = closing(words, at) if words[at].text in OPEN else at + 1
    return at


def extends_clauses(words: Sequence[Token]) -> list[Extends]:
    """The extends clauses among the tokens of a class; that behind its name included."""
    found: list[Extends] = []
    for i, depth in depths(words):
        if depth == 0 and words[i].text == "extends" and i + 1 < len(words):
            end = i + 1
            while end < len(words) and (words[end].kind == "name" or words[end].text == "."):
                end += 1
            base = _joined(words[i + 1 : end])
            found.append(Extends(base, _broken(words, end), words[i].start, _bound(words, end)))
    return found


def _bound(words: Sequence[Token], at: int) -> dict[str, tuple[int, int]]:
    """First and last byte of the expressions in `(name = expression, …)`, which begins at token `at`."""
    if at >= len(words) or words[at].text != "(":
        return {}
    return {
        one[0].text: (one[2].start, one[-1].end)
        for one in arguments(words, at)
        if len(one) > 2 and one[1].text == "="
    }


def arguments(words: Sequence[Token], at: int) -> list[list[Token]]:
    """The tokens of each argument in the brackets that open at token `at`."""
    inside = words[at + 1 : closing(words, at) - 1]
    found: list[list[Token]] = [[]]
    for (_, depth), word in zip(depths(inside), inside, strict=True):
        if word.text == "," and depth == 0:
            found.append([])
        else:
            found[-1].append(word)
    return [one for one in found if one]


def _broken(words: Sequence[Token], at: int) -> tuple[frozenset[str], ...]:
    """The `break connect(a, b)` of the modification that begins at token `at`."""
    if at >= len(words) or words[at].text != "(":
        return ()
    found: list[frozenset[str]] = []
    end = closing(words, at)
    for i in range(at, end):
        if words[i].text == "break" and words[i + 1].text == "connect":
            found.append(frozenset(map(_joined, arguments(words, i + 2))))
    return tuple(found)


def connect_clauses(words: Sequence[Token]) -> list[ConnectClause]:
    """The connect clauses among the tokens of a class (those to be broken do not count)."""
    found: list[ConnectClause] = []
    for i, depth in depths(words):
        if depth == 0 and words[i].text == "connect" and i + 1 < len(words) and words[i + 1].text == "(":
            ends = [_joined(one) for one in arguments(words, i + 1)]
            stop = find_outside(words, i + 1, ";")
            if len(ends) == 2 and stop < len(words):
                found.append(ConnectClause(ends[0], ends[1], words[i].start, words[stop].end))
    return found


def _joined(words: Sequence[Token]) -> str:
    return "".join(word.text for word in words)


def find_base(heads: Sequence[ClassHead], derived: str, base: str) -> ClassHead | None:
    """The class of the file that `base` means where the class `derived` extends it, looked up from the inside
    outwards; None for one of another file."""
    scope = derived.split(".")[:-1]
    by_name = {head.name: head for head in heads}
    for end in range(len(scope), -1, -1):
        found = by_name.get(".".join([*scope[:end], base]))
        if found is not None:
            return None if found.name == derived else found
    return None


def depths(words: Sequence[Token]) -> Iterator[tuple[int, int]]:
    """Index and bracket depth of every token."""
    depth = 0
    for i, token in enumerate(words):
        depth -= token.text in CLOSE
        yield i, depth
        depth += token.text in OPEN


def closing(words: Sequence[Token], at: int) -> int:
    """Index behind the bracket that closes the one at `at`."""
    depth = 0
    for i in range(at, len(words)):
        depth += (words[i].text in OPEN) - (words[i].text in CLOSE)
        if depth == 0:
            return i + 1
    return len(words)


def name_end(words: Sequence[Token], at: int) -> int:
    """Index behind the dotted name that begins at `at`."""
    at += words[at].text == "." if at < len(words) else 0
    while at < len(words) and words[at].kind == "name":
        at += 1
        if at >= len(words) or words[at].text != ".":
            break
        at += 1
    return at


def imports(words: Sequence[Token]) -> dict[str, str]:
    """What import clauses name, local name -> full name; the first clause of a name counts."""
    found: dict[str, str] = {}
    for i, word in enumerate(words):
        if word.text != "import":
            continue
        clause = [w.text for w in takewhile(lambda w: w.text != ";" and w.kind != "text", words[i + 1 :])]
        if "=" in clause:
            named = {clause[0]: "".join(clause[clause.index("=") + 1 :])}
        elif "{" in clause:
            package = "".join(clause[: clause.index("{") - 1])
            named = {name: f"{package}.{name}" for name in clause[clause.index("{") + 1 : -1] if name != ","}
        else:
            named = {clause[-1]: "".join(clause)} if clause and clause[-1] != "*" else {}
        found = named | found
    return found


def imported(words: Sequence[Token], name: str) -> str:
    """The name with what an import clause says of its first part."""
    first, dot, rest = name.partition(".")
    return imports(words).get(first, first) + dot + rest
