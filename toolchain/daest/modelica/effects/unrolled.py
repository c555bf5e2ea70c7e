"""Loops of equations written out, so that one of their equations can be opened.

`for i in 2:n loop C*der(T[i]) = q[i-1] - q[i]; end for;` becomes `C*der(T[2]) = q[1] - q[2];` and so on: the
same equations in the same order. Loops with connect clauses likewise, as `for i in 1:n-1 loop
connect(a[i].n, a[i+1].p); end for;`, so that one of their connections can be opened.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from daest.modelica.language.outline import (
    ClassHead,
    Edit,
    Token,
    class_heads,
    class_tokens,
    closing,
    edited,
)

_LOOP, _END, _CONNECT = "loop", "end", "connect"
_BLOCKS = ("for", "if", "when")
_BEFORE_STATEMENTS = (";", "equation", "algorithm", "then", "else", _LOOP)


@dataclass(frozen=True)
class _Loop:
    """`for INDEX in FIRST:LAST loop`, with the tokens `inside` of it and where it stands in the text."""

    index: str
    first: str
    last: str
    inside: Sequence[Token]
    start: int
    stop: int

    def written_out(self, source: bytes, low: int, high: int) -> Edit:
        """Its statements for all numbers from `low` to `high`."""
        numbers = range(low, high + 1)
        lines = [line for n in numbers for line in _statements(source, self.inside, self.index, n)]
        return Edit(self.start, self.stop, f"\n{_indent(source, self.start)}".join(lines))


def _loop_at(words: Sequence[Token], at: int) -> _Loop | None:
    """The loop whose index is the token `at`; None where it is none, as in `sum(x[i] for i in 1:n)`."""
    if at < 2 or words[at - 1].text != "for" or [w.text for w in words[at + 1 : at + 2]] != ["in"]:
        return None
    if words[at - 2].text not in _BEFORE_STATEMENTS:
        return None
    body = next(i for i in range(at, len(words)) if words[i].text == _LOOP) + 1
    end = next(i for i in range(body, len(words)) if words[i].text == _END)
    first, _, last = "".join(w.text for w in words[at + 2 : body - 1]).partition(":")
    stop = next(w for w in words[end:] if w.text == ";").end
    return _Loop(words[at].text, first, last, words[body:end], words[at - 1].start, stop)


def without_loop(source: bytes, words: Sequence[Token], at: int, n_equations: int) -> bytes | None:
    """The text with a loop of a class written out, whose index is the token `at` and which stands for
    `n_equations`; None for one that is not of the form `for i in FIRST:LAST loop`, with a number as its
    first, around equations of one line each."""
    loop = _loop_at(words, at)
    if loop is None or not loop.first.isdecimal() or not loop.last or ":" in loop.last:
        return None
    n_statements = sum(w.text == ";" for w in loop.inside)
    is_nested = any(w.text in _BLOCKS for w in loop.inside)
    if is_nested or n_equations % max(n_statements, 1):  # the latter where some of them are of arrays
        return None
    low = int(loop.first)
    return edited(source, [loop.written_out(source, low, low + n_equations // n_statements - 1)])


def with_connects_written_out(source: bytes, head: ClassHead) -> bytes:
    """The text in which the connect clauses of a class name each element of an array by its number: loops
    around them are written out, and subscripts such as `n-1` worked out."""
    while (edit := _loop_of_connects(source, class_tokens(source, head))) is not None:
        source = edited(source, [edit])
        head = _again(source, head)
    return edited(source, _subscripts(class_tokens(source, head)))


def _again(source: bytes, head: ClassHead) -> ClassHead:
    return next(h for h in class_heads(source) if h.name == head.name)


def _loop_of_connects(source: bytes, words: Sequence[Token]) -> Edit | None:
    """The first loop over whole numbers with connect clauses inside, and maybe equations of one statement
    each, written out; None for none."""
    known = _known_numbers(words)
    for loop in filter(None, (_loop_at(words, at) for at in range(1, len(words)))):
        low, high = _whole(loop.first, known), _whole(loop.last, known)
        before = ["", *(w.text for w in loop.inside)]
        begins = {w.text for w, last in zip(loop.inside, before, strict=False) if last in ("", ";")}
        if low is not None and high is not None and _CONNECT in begins and not begins & set(_BLOCKS):
            return loop.written_out(source, low, high)
    return None


def _known_numbers(words: Sequence[Token]) -> dict[str, int]:
    """The integers that a class gives a number."""
    return {
        words[i + 1].text: int(words[i + 3].text)
        for i in range(len(words) - 3)
        if words[i].text == "Integer" and words[i + 2].text == "=" and words[i + 3].text.isdecimal()
    }


def _whole(text: str, known: Mapping[str, int]) -> int | None:
    """A sum of whole numbers and known integers; None for anything else."""
    parts = re.findall(r"[+-]?\w+", text)
    if not parts or "".join(parts) != text:
        return None
    values = [(part.lstrip("+-"), -1 if part.startswith("-") else 1) for part in parts]
    if not all(name.isdecimal() or name in known for name, _ in values):
        return None
    return sum(sign * (int(name) if name.isdecimal() else known[name]) for name, sign in values)


def _subscripts(words: Sequence[Token]) -> list[Edit]:
    """What replaces the subscripts of connect clauses that are no plain numbers."""
    known, edits = _known_numbers(words), []
    for at, word in enumerate(words):
        if word.text != _CONNECT:
            continue
        behind = closing(words, at + 1)
        for i in range(at, behind):
            if words[i].text != "[":
                continue
            inside = words[i + 1 : closing(words, i) - 1]
            value = _whole("".join(w.text for w in inside), known)
            if value is not None and inside:
                edits.append(Edit(inside[0].start, inside[-1].end, str(value)))
    return edits


def _indent(source: bytes, at: int) -> str:
    before = source[source.rfind(b"\n", 0, at) + 1 : at].decode()
    return before if not before.strip() else ""


def _statements(source: bytes, inside: Sequence[Token], index: str, number: int) -> Iterator[str]:
    """The statements of a loop with a number for its index."""
    begin = 0
    for i, word in enumerate(inside):
        if word.text == ";":
            yield _with_number(source, inside[begin : i + 1], index, number)
            begin = i + 1


def _with_number(source: bytes, statement: Sequence[Token], index: str, number: int) -> str:
    start = statement[0].start
    edits = []
    for i, word in enumerate(statement):
        if word.text != index or word.kind != "name" or (i and statement[i - 1].text == "."):
            continue
        sign, value = (w.text for w in [*statement[i + 1 : i + 3], word, word][:2])
        around = statement[i - 1].text, statement[i + 3].text if i + 3 < len(statement) else ""
        is_sum = around[0] in ("[", ",") and around[1] in ("]", ",")
        if is_sum and sign in ("+", "-") and value.isdecimal():
            further = number + int(value) * (1 if sign == "+" else -1)
            edits.append(Edit(word.start - start, statement[i + 2].end - start, str(further)))
        else:
            edits.append(Edit(word.start - start, word.end - start, str(number)))
    return edited(source[start : statement[-1].end], edits).decode()
