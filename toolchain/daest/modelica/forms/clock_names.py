"""Clocks without a name get one, and what is sampled by a clock an equation of its own.

The compiler takes a clock by its name alone, and sample(x, c) as the whole right side of an equation alone.
So it is given `sample(u, Clock(0.1))` as `sample(u, clk__1)` with `Clock clk__1 = Clock(0.1);`, and
`y = k*sample(u, c)` as `y = k*sam__1` with `Real sam__1; equation sam__1 = sample(u, c);`, and so is
`Real y = sample(u, c);`. Declarations stand behind the name of the class, equations behind the word
`equation`, on the lines of these, and what is replaced keeps its length: all else stays where it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from daest.modelica.language.outline import (
    Edit,
    Token,
    arguments,
    class_heads,
    class_tokens,
    closing,
    depths,
    edited,
    name_end,
)

_CLOCKS = ("Clock", "ClockInput", "ClockOutput")
_DISCRETE = ("Boolean", "Integer")
_CONVERSIONS = ("subSample", "superSample", "shiftSample", "backSample")
_PREFIXES = ("parameter", "constant", "input", "output", "discrete", "public", "protected", "final", "inner")
_BEFORE_CLAUSE = (";", "loop", "then", "else", "equation", "algorithm")
_OWN = re.compile(rb"\b(clk|sam)__\d")


@dataclass(frozen=True)
class _Call:
    """A call from token `first` to before `behind`, the type of what stands for it, and `target`, the name
    that it is the declared value of, with the token `start` from which it is left out there."""

    first: int
    behind: int
    type_name: str
    target: str = ""
    start: int = 0


@dataclass
class _Text:
    """A text, and what is to be changed in it."""

    text: bytes
    edits: list[Edit] = field(default_factory=list)
    count: int = 0

    def replaced(self, words: Sequence[Token], new: str) -> str:
        """What the words said, on one line; `new` stands there now, with spaces for the rest."""
        old = self.text[words[0].start : words[-1].end]
        rest = re.sub(rb"[^\r\n]", b" ", old[len(new) :]).decode()
        self.edits.append(Edit(words[0].start, words[-1].end, new + rest))
        return " ".join(old.decode("utf-8", "replace").split())

    def named(self, prefix: str, words: Sequence[Token]) -> tuple[str, str]:
        """A new name that stands for a call, and the call; no name where the call is shorter than it."""
        name = f"{prefix}{self.count + 1}"
        if len(name) > words[-1].end - words[0].start:
            return "", ""
        self.count += 1
        return name, self.replaced(words, name)


def with_named_clocks(text: bytes) -> bytes:
    """The text in which every clock has a name, and what is sampled by such a name an equation of its own.

    >>> print(with_named_clocks(b"model A Real y; equation y = sample(x, Clock(1)); end A;").decode())
    model A Clock clk__1 = Clock(1);  Real y; equation y = sample(x, clk__1  ); end A;
    """
    if b"Clock" not in text or _OWN.search(text):
        return text
    return _with_equations(_with_declarations(text))


def _with_declarations(text: bytes) -> bytes:
    """The text with names in place of Clock(…), one for all that are the same in a class. They differ between
    classes, which may inherit from each other. Equations of `when Clock() then` stand alone: their clock is
    that of what they use either way."""
    made = _Text(text)
    for words in _classes(text):
        known: dict[str, str] = {}
        declared = ""
        for call in _clocks(words):
            called = words[call.first : call.behind]
            said = "".join(word.text for word in called)
            if said == "Clock()" and words[call.first - 1].text == "when":
                made.replaced(words[call.first - 1 : call.behind + 1], "")
                made.replaced(_end_of_when(words, call.behind), "")
            elif said in known:
                made.replaced(called, known[said])
            else:
                name, value = made.named("clk__", called)
                declared += f" Clock {name} = {value};" if name else ""
                known |= {said: name} if name else {}
        _declare(made, words, declared)
    return edited(text, made.edits)


def _end_of_when(words: Sequence[Token], at: int) -> Sequence[Token]:
    """The next `end when;`. Clauses of equations on clocks do not nest."""
    for i in range(at, len(words) - 2):
        if words[i].text == "end" and words[i + 1].text == "when":
            return words[i : i + 3]
    return words[at : at + 1]


def _with_equations(text: bytes) -> bytes:
    """The text with names in place of sample(…), and their equations."""
    made = _Text(text)
    for words in _classes(text):
        declared = equations = ""
        for call in _samples(words):
            if call.target:
                equations += f" {call.target} {made.replaced(words[call.start : call.behind], '')};"
                continue
            name, value = made.named("sam__", words[call.first : call.behind])
            if name:
                declared += f" {call.type_name} {name};"
                equations += f" {name} = {value};"
        _declare(made, words, declared)
        if equations:
            at, word = _equations_begin(words)
            made.edits.append(Edit(at, at, f"{word}{equations} "))
    return edited(text, made.edits)


def _classes(text: bytes) -> Iterator[list[Token]]:
    for head in class_heads(text):
        if head.kind in ("model", "block", "class"):
            yield class_tokens(text, head)


def _declare(made: _Text, words: Sequence[Token], declared: str) -> None:
    if declared:
        at = _head_end(words)
        made.edits.append(Edit(at, at, f"{declared} "))


def _head_end(words: Sequence[Token]) -> int:
    """Where the elements of a class begin: behind its name, what it extends, and its comment."""
    at = 1
    if words[at].text == "extends":
        at = name_end(words, at + 1)
    if words[at].text == "(":
        at = closing(words, at)
    while words[at].kind == "text" or words[at].text == "+":
        at += 1
    return words[at - 1].end


def _equations_begin(words: Sequence[Token]) -> tuple[int, str]:
    """Where equations of the class may stand, and the word before them where it has no section of them."""
    last = words[-1].end
    for i, (_, depth) in enumerate(depths(words)):
        if words[i].text == "equation" and words[i - 1].text != "initial":
            return words[i].end, ""
        if depth == 0 and words[i].text == "annotation" and words[i - 1].text == ";":
            last = words[i - 1].end
    return last, " equation"


def _clocks(words: Sequence[Token]) -> Iterator[_Call]:
    """Calls of Clock(…), but for those that are the value of a declaration or an equation."""
    loops = _inside(words, "for")
    for i in range(1, len(words) - 1):
        if words[i].text == "Clock" and words[i + 1].text == "(" and not loops[i]:
            behind = closing(words, i + 1)
            if words[i - 1].text not in ("=", ".") or not _ends(words, behind):
                yield _Call(i, behind, "Clock")


def _samples(words: Sequence[Token]) -> Iterator[_Call]:
    """Calls of sample(x, c), c a clock, and of sample(x) that stand outside of `when`, but for those that are
    the whole right side of an equation."""
    loops, whens, types = _inside(words, "for"), _inside(words, "when"), _types(words)
    sections = (i for i, word in enumerate(words) if word.text in ("equation", "algorithm"))
    first_section = next(sections, len(words))
    last = 0
    for i in range(1, len(words) - 1):
        if i < last or words[i].text != "sample" or words[i + 1].text != "(" or loops[i]:
            continue
        found, last = arguments(words, i + 1), closing(words, i + 1)
        if whens[i] if len(found) == 1 else len(found) != 2 or not _is_clock(found[1], types):
            continue
        if words[i - 1].text != "=" or not _ends(words, last):
            what = types.get(found[0][0].text, "") if len(found[0]) == 1 else ""
            yield _Call(i, last, what if what in _DISCRETE else "Real")
        elif i < first_section:
            target = _declared_before(words, i - 1)
            if types.get(target, "") not in ("", *_CLOCKS):
                yield _Call(i, last, "", target, i - 1)


def _declared_before(words: Sequence[Token], at: int) -> str:
    """The name whose declaration has the `=` at `at`, or nothing."""
    before = at - 1
    if words[before].text == ")":
        depth = 0
        while before > 0:
            depth += (words[before].text == ")") - (words[before].text == "(")
            before -= 1
            if depth == 0:
                break
    return words[before].text if words[before].kind == "name" else ""


def _ends(words: Sequence[Token], behind: int) -> bool:
    """Whether the expression ends with a call."""
    if behind >= len(words):
        return True
    return words[behind].kind == "text" or words[behind].text in (";", ",", ")", "annotation", "if")


def _is_clock(argument: Sequence[Token], types: dict[str, str]) -> bool:
    first = argument[0].text
    return types.get(first) in _CLOCKS if len(argument) == 1 else first in _CONVERSIONS


def _types(words: Sequence[Token]) -> dict[str, str]:
    """The last part of the type's name of each component that the class declares."""
    found: dict[str, str] = {}
    flat = [depth for _, depth in depths(words)]
    starts = True
    for i, word in enumerate(words):
        end = name_end(words, i)
        if i and starts and end < len(words) and words[end].kind == "name" and flat[i] == 0:
            found.update(dict.fromkeys(_listed(words, flat, end), words[end - 1].text))
        starts = word.text == ";" or word.kind == "text" or word.text in _PREFIXES or i == 0
    return found


def _listed(words: Sequence[Token], flat: Sequence[int], at: int) -> Iterator[str]:
    """The names of the list of components that begins at `at`."""
    declares = True
    for word, depth in zip(words[at:], flat[at:], strict=True):
        if depth == 0 and word.text == ";":
            return
        if declares and word.kind == "name":
            yield word.text
        declares = depth == 0 and word.text == ","


def _inside(words: Sequence[Token], clause: str) -> list[bool]:
    """Whether each token stands in a `for` clause, whose names are known there alone, or in a `when`."""
    found, depth = [], 0
    for before, word in zip([words[0], *words], words, strict=False) if words else ():
        if word.text == clause:
            depth += (before.text in _BEFORE_CLAUSE) - (before.text == "end")
        found.append(depth > 0)
    return found
