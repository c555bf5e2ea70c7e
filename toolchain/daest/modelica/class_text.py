"""The text of one class of a file: its tokens, what it extends, its connect clauses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from daest.modelica.outline import ClassHead, Token, class_heads, tokens

OPEN, CLOSE = ("(", "[", "{"), (")", "]", "}")


@dataclass(frozen=True)
class Extends:
    """An extends clause: the name of the base as written, and the connections that it removes."""

    base: str
    broken: tuple[frozenset[str], ...]
    start: int


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
    inner = {h.start for h in class_heads(source) if h.name.startswith(head.name + ".")}
    words = list(tokens(source, head.start))
    last = words[0].text
    if len(words) > 1 and words[1].text == "=":
        return words[: _statement_end(words)]
    found: list[Token] = []
    i = 0
    while i < len(words):
        follows = words[i + 1].text if i + 1 < len(words) else ""
        if words[i].text == "end" and follows == last:
            return found
        if words[i].start in inner and follows != "=":
            i = _class_end(words, i)
            continue
        found.append(words[i])
        i += 1
    return found


def _class_end(words: Sequence[Token], at: int) -> int:
    """Index behind the `end Name` of the class whose name stands at `at`."""
    for i in range(at + 1, len(words) - 1):
        if words[i].text == "end" and words[i + 1].text == words[at].text:
            return i + 2
    return len(words)


def _statement_end(words: Sequence[Token]) -> int:
    """Index of the semicolon that ends the statement at the first word."""
    depth = 0
    for i, word in enumerate(words):
        depth += (word.text in OPEN) - (word.text in CLOSE)
        if depth < 0 or (depth == 0 and word.text == ";"):
            return i  # a bracket around a redeclared class ends it, too
    return len(words)


def extends_clauses(words: Sequence[Token]) -> list[Extends]:
    """The extends clauses among the tokens of a class; that behind its name included."""
    found: list[Extends] = []
    for i, depth in depths(words):
        if depth == 0 and words[i].text == "extends" and i + 1 < len(words):
            end = i + 1
            while end < len(words) and (words[end].kind == "name" or words[end].text == "."):
                end += 1
            base = "".join(token.text for token in words[i + 1 : end])
            found.append(Extends(base, _broken(words, end), words[i].start))
    return found


def _broken(words: Sequence[Token], at: int) -> tuple[frozenset[str], ...]:
    """The `break connect(a, b)` of the modification that begins at token `at`."""
    if at >= len(words) or words[at].text != "(":
        return ()
    found: list[frozenset[str]] = []
    end = closing(words, at)
    for i in range(at, end):
        if words[i].text == "break" and words[i + 1].text == "connect":
            found.append(frozenset(_arguments(words, i + 2)))
    return tuple(found)


def connect_clauses(words: Sequence[Token]) -> list[ConnectClause]:
    """The connect clauses among the tokens of a class (those to be broken do not count)."""
    found: list[ConnectClause] = []
    for i, depth in depths(words):
        if depth == 0 and words[i].text == "connect" and i + 1 < len(words) and words[i + 1].text == "(":
            arguments = _arguments(words, i + 1)
            end = closing(words, i + 1)
            while end < len(words) and words[end].text != ";":
                end = closing(words, end) if words[end].text in OPEN else end + 1
            if len(arguments) == 2 and end < len(words):
                found.append(ConnectClause(arguments[0], arguments[1], words[i].start, words[end].end))
    return found


def find_base(heads: Sequence[ClassHead], derived: ClassHead, base: str) -> ClassHead | None:
    """The class of the file that `base` means where `derived` extends it: looked up from the inside
    outwards."""
    scope = derived.name.split(".")[:-1]
    by_name = {head.name: head for head in heads}
    for end in range(len(scope), -1, -1):
        found = by_name.get(".".join([*scope[:end], base]))
        if found is not None:
            return found
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


def _arguments(words: Sequence[Token], at: int) -> list[str]:
    """The arguments, as text without white space, of the call whose bracket opens at `at`."""
    arguments = [""]
    depth = 0
    for token in words[at + 1 : closing(words, at) - 1]:
        depth += (token.text in OPEN) - (token.text in CLOSE)
        if token.text == "," and depth == 0:
            arguments.append("")
        else:
            arguments[-1] += token.text
    return arguments
