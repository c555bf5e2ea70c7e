"""Algorithm sections of models read from source text, for those that the compiler itself does not take.

The compiler refuses sections with loops, with a variable that is read and then assigned, and with several
results. Such a section is shown to it as an assertion that always holds; the flat form tells each component
that has the assertion, and the algorithm is read here with the names of that component.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from daest.modelica.forms.dialect import MARK, OPERATORS
from daest.modelica.forms.function_text import StatementParser
from daest.modelica.language import syntax as s
from daest.modelica.language.expressions import split_path
from daest.modelica.language.outline import CLOSE, OPEN, Token, class_heads, class_tokens, laid_over
from daest.modelica.language.parse import ParseError

_SECTIONS = ("equation", "algorithm", "public", "protected", "annotation", "external")


@dataclass(frozen=True)
class AlgorithmText:
    """One algorithm section: bytes `start` (at `initial` or `algorithm`) to `end`, and its statements."""

    start: int
    end: int
    is_initial: bool
    body: tuple[s.Statement, ...]


def algorithm_texts(text: bytes, source: int) -> tuple[AlgorithmText, ...]:
    """The algorithm sections of the models of a file that can be read here and hidden; `source` is the number
    that places of their statements carry."""
    found: list[AlgorithmText] = []
    for head in class_heads(text):
        if head.kind in ("model", "block", "class"):
            found += _sections(class_tokens(text, head), source)
    ordered = sorted(found, key=lambda one: one.start)
    return tuple(one for one in ordered if _written(text[one.start : one.end], _mark(0, ())) is not None)


def hidden(text: bytes, sections: Sequence[AlgorithmText], asked: Sequence[tuple[str, ...]]) -> bytes | None:
    """The file with an assertion in place of each section; no line or byte moves. `asked` are names whose
    meaning the compiler is to tell, for each section. None where there is no room for them."""
    made = bytearray(text)
    for i, section in enumerate(sections):
        instead = _written(text[section.start : section.end], _mark(i, asked[i]))
        if instead is None:
            return None
        made[section.start : section.end] = instead
    return bytes(made)


def _mark(number: int, asked: Iterable[str]) -> list[bytes]:
    """The words of an assertion whose message has a number and the names that are asked for."""
    names = tuple(asked)
    words = ["equation ", "assert", "(", "true", ",", f'"{MARK}{",".join((str(number), *names))}"']
    for name in names:
        words += ["+", "String(", *re.split(r"(?=\.)", name), ")"]
    return [word.encode() for word in (*words, ")", ";")]


def _written(region: bytes, words: Sequence[bytes]) -> bytes | None:
    """The words in place of a region, its line ends kept; None where they do not fit."""
    made = bytearray(laid_over(region))
    at = 0
    for word in words:
        while at + len(word) <= len(made) and made[at : at + len(word)].strip(b" "):
            at += 1
        if at + len(word) > len(made):
            return None
        made[at : at + len(word)] = word
        at += len(word)
    return bytes(made)


def _sections(words: Sequence[Token], source: int) -> Iterator[AlgorithmText]:
    i = 0
    while i < len(words):
        if words[i].text != "algorithm" or (i and words[i - 1].text == "end"):
            i += 1
            continue
        is_initial = i > 0 and words[i - 1].text == "initial"
        end = _section_end(words, i + 1)
        inside = list(words[i + 1 : end])
        start = words[i - 1 if is_initial else i].start
        i = end
        try:
            body = StatementParser(inside, source=source, takes_when=True).statements()
        except ParseError:
            continue
        if inside:
            yield AlgorithmText(start, inside[-1].end, is_initial, body)


def _section_end(words: Sequence[Token], at: int) -> int:
    """Index of the word that ends the section whose statements begin at `at`."""
    depth = 0
    for i in range(at, len(words)):
        word, before = words[i].text, words[i - 1].text
        depth += (word in OPEN) - (word in CLOSE)
        if depth == 0 and words[i].kind == "name" and before in (";", "algorithm"):
            follows = words[i + 1].text if i + 1 < len(words) else ""
            if word in _SECTIONS or (word == "initial" and follows in ("equation", "algorithm")):
                return i
    return len(words)


def with_algorithms(source: s.FlatSource, sections: Sequence[AlgorithmText]) -> s.FlatSource:
    """The flat source with the hidden sections, each with the names of the component that it stands in.
    Raises UnknownNames for those that the flat source does not tell."""
    known, unknown = _known(source), [dict[str, None]() for _ in sections]
    ordinary, initial = list(source.algorithms), list(source.initial_algorithms)
    for mark in source.marks:
        section = sections[mark.number]
        names = _Names(known, source.literals, mark.component, mark.meant, unknown[mark.number])
        body = tuple(names.changed(statement, frozenset()) for statement in section.body)
        first = section.body[0].span if section.body else None
        (initial if section.is_initial else ordinary).append(s.FlatAlgorithm(body, mark.component, first))
    if any(unknown):
        raise UnknownNames(tuple(tuple(names) for names in unknown))
    return replace(source, algorithms=tuple(ordinary), initial_algorithms=tuple(initial), marks=())


class UnknownNames(Exception):
    """Names of each section that are no variables of its component: constants of packages, what `outer`
    means. The compiler knows them."""

    def __init__(self, names: tuple[tuple[str, ...], ...]) -> None:
        super().__init__(names)
        self.names = names


def _known(source: s.FlatSource) -> frozenset[str]:
    """All variables, records and components of the flat form, without indices."""
    found: set[str] = set()
    for variable in source.variables:
        parts = [ident for ident, _ in split_path(variable.name)]
        found |= {".".join(parts[: i + 1]) for i in range(len(parts))}
    return frozenset(found)


@dataclass(frozen=True)
class _Names:
    """Names as they stand in a class, and what they mean in one component of it. `unknown` collects those
    without a meaning."""

    known: frozenset[str]
    literals: Mapping[str, int]
    component: str
    meant: Mapping[str, s.Node]
    unknown: dict[str, None]

    def changed(self, node: Any, local: frozenset[str]) -> Any:
        """A statement or expression with the full names; `local` are iterators of loops around it."""
        if isinstance(node, s.For | s.Comprehension):
            local = local | {name for name, _ in node.iterators}
        made = s.rebuilt(node, lambda part: self.changed(part, local))
        if isinstance(made, s.Name) and made.name not in local:
            return self._full(made)
        if isinstance(made, s.Call) and made.function in OPERATORS:
            return replace(made, function=OPERATORS[made.function], builtin=True)
        return made

    def _full(self, node: s.Name) -> s.Node:
        name = node.name
        made = f"{self.component}.{name}" if self.component else name
        if ".".join(ident for ident, _ in split_path(made)) in self.known:
            return replace(node, name=made)
        if name == "time" or name in self.literals:
            return node
        if name in self.meant:
            found = self.meant[name]
            return replace(found, subscripts=node.subscripts) if isinstance(found, s.Name) else found
        ends = [literal for literal in self.literals if literal.endswith(f".{name}")]
        if ends and "." in name:
            return replace(node, name=ends[0])
        self.unknown[name] = None
        return node
