"""Modifications of what a class does not have: `extends Motor(K = 3)` where it is called `k`.

The compiler checks the names of modifications where a component is declared, but neither those of an extends
clause nor those inside of another modification: it passes over them, and the model runs with other values.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from daest.errors import ModelError
from daest.modelica import syntax as s
from daest.modelica.expressions import split_path
from daest.modelica.outline import (
    CLOSE,
    KINDS,
    OPEN,
    ClassHead,
    Token,
    class_heads,
    class_tokens,
    closing,
    extends_clauses,
    find_base,
    place_of,
    tokens,
)
from daest.near import near_names

_PREFIXES = (
    *("final", "inner", "outer", "replaceable", "redeclare", "flow", "stream", "discrete"),
    *("parameter", "constant", "input", "output", "each"),
)
_OTHERS = (
    "import",
    "extends",
    "annotation",
    "encapsulated",
    "partial",
    "expandable",
    "impure",
    "pure",
    "end",
)
_ATTRIBUTES = (
    *("start", "fixed", "min", "max", "nominal", "unit", "displayUnit", "quantity", "stateSelect"),
    *("unbounded", "absoluteValue"),
)


@dataclass(frozen=True)
class _Modification:
    """`name(inner) = …` at a token; `is_class` where a class is redeclared."""

    name: str
    at: Token
    inner: tuple[_Modification, ...]


def check_modifications(source: s.FlatSource, text: bytes, class_name: str, file: str) -> None:
    """Raise ModelError `model-unknown-name` for the first modification, in the class or in the classes of its
    file that it extends, of a name that nothing has."""
    heads = class_heads(text)
    head = next((one for one in heads if one.name == class_name), None)
    if head is not None:
        _Check(source, text, heads, file).of_class(head)


@dataclass(frozen=True)
class _Check:
    source: s.FlatSource
    text: bytes
    heads: Sequence[ClassHead]
    file: str

    @cached_property
    def known(self) -> dict[str, bool]:
        """Variables and components of the flat form without indices -> whether it is a variable."""
        found: dict[str, bool] = {}
        for variable in self.source.variables:
            parts = [ident for ident, _ in split_path(variable.name)]
            for i in range(1, len(parts)):
                found.setdefault(".".join(parts[:i]), False)
            found[".".join(parts)] = True
        return found

    def of_class(self, head: ClassHead) -> None:
        words = class_tokens(self.text, head)
        for base, modifications in _extensions(words):
            found = find_base(self.heads, head, base)
            own = None if found is None else names_of(self.text, self.heads, found)
            for one in modifications:
                self._check(one, "", own)
            if found is not None and found.name != head.name:
                self.of_class(found)
        for name, modifications in _components(words):
            for one in modifications:
                self._check(one, name, None)

    def _check(self, one: _Modification, prefix: str, own: frozenset[str] | None) -> None:
        full = f"{prefix}.{one.name}" if prefix else one.name
        if full in self.known:
            is_variable = self.known[full]
            for inner in one.inner:
                if not is_variable:
                    self._check(inner, full, None)
                elif inner.name not in _ATTRIBUTES:
                    raise self._missing(inner, f"variable `{full}`", _ATTRIBUTES)
            return
        # A component that a condition leaves out, and a class, are no variables: they are declared, though.
        declared = self._declared(prefix) if own is None else own
        if declared is not None and one.name.partition(".")[0] not in declared:
            below = [name for name in self.known if name.rpartition(".")[0] == prefix]
            where = f"`{prefix}`" if prefix else "the class that is extended"
            raise self._missing(one, where, [name.rpartition(".")[2] for name in below])

    def _declared(self, prefix: str) -> frozenset[str] | None:
        """Names outside of brackets in the files that declare the variables of a component; None where there
        are none."""
        inside = f"{prefix}." if prefix else ""
        numbers = {
            x.span.source
            for x in self.source.variables
            if x.span is not None and _plain(x.name).startswith(inside)
        }
        if not numbers or not numbers <= set(self.source.texts):
            return None
        return frozenset(
            name for number in numbers for name in _outside(list(tokens(self.source.texts[number][1])))
        )

    def _missing(self, one: _Modification, where: str, names: Sequence[str]) -> ModelError:
        return _nothing_there(one, where, names, self.text, self.file)


def check_class_modification(
    words: Sequence[Token], opening: int, base: ClassHead, heads: Sequence[ClassHead], text: bytes, file: str
) -> None:
    """As `check_modifications`, of the modification of a class of the file, whose bracket opens at word
    `opening`. Raises ModelError for a name that the class does not have."""
    names = names_of(text, heads, base)
    for one in _modifications(words, opening):
        if names is not None and one.name.partition(".")[0] not in names:
            raise _nothing_there(one, f"`{base.name}`", sorted(names), text, file)


def names_of(text: bytes, heads: Sequence[ClassHead], head: ClassHead) -> frozenset[str] | None:
    """Names outside of brackets in a class and in those that it extends; None if one of them is in another
    file."""
    words = class_tokens(text, head)
    found = set(_outside(words))
    bases = [clause.base for clause in extends_clauses(words)]
    if len(words) > 2 and words[1].text == "=":
        bases = [words[2].text]
    for name in bases:
        base = find_base(heads, head, name)
        inherited = None if base is None or base.name == head.name else names_of(text, heads, base)
        if inherited is None:
            return None
        found |= inherited
    return frozenset(found)


def _nothing_there(
    one: _Modification, where: str, names: Sequence[str], text: bytes, file: str
) -> ModelError:
    near = near_names(one.name, names, 2)
    hint = f"Did you mean {' or '.join(f'`{name}`' for name in near)}? " if near else ""
    return ModelError(
        "model-unknown-name",
        f"{where} has no `{one.name}` that could be modified",
        where=place_of(file, text, one.at.start),
        remedy=f"{hint}Name something that it declares, or leave the modification out.",
    )


def _plain(name: str) -> str:
    return ".".join(ident for ident, _ in split_path(name))


def _outside(words: Sequence[Token]) -> Iterator[str]:
    depth = 0
    for word in words:
        depth += (word.text in OPEN) - (word.text in CLOSE)
        if depth == 0 and word.kind == "name":
            yield word.text


def _extensions(words: Sequence[Token]) -> Iterator[tuple[str, tuple[_Modification, ...]]]:
    """Base classes with the modifications of the clause."""
    for clause in extends_clauses(words):
        at = next(i for i, word in enumerate(words) if word.start == clause.start) + 1
        while at < len(words) and (words[at].kind == "name" or words[at].text == "."):
            at += 1
        yield clause.base, _modifications(words, at)


def _components(words: Sequence[Token]) -> Iterator[tuple[str, tuple[_Modification, ...]]]:
    """Declared components that are modified."""
    for statement in _declarations(words):
        at = 0
        while at < len(statement) and statement[at].text in _PREFIXES:
            at += 1
        if at >= len(statement) or statement[at].text in (*KINDS, *_OTHERS):
            continue
        while at < len(statement) and (statement[at].kind == "name" or statement[at].text == "."):
            at += 1
            if at < len(statement) and statement[at].kind == "name" and statement[at - 1].text != ".":
                break
        yield from _listed(statement, at)


def _listed(words: Sequence[Token], at: int) -> Iterator[tuple[str, tuple[_Modification, ...]]]:
    """`a(…) = 1, b[3](…)` from word `at` on, behind the class and its size."""
    if at < len(words) and words[at].text == "[":
        at = closing(words, at)
    while at < len(words) and words[at].kind == "name":
        name, at = words[at].text, at + 1
        if at < len(words) and words[at].text == "[":
            at = closing(words, at)
        if at < len(words) and words[at].text == "(":
            yield name, _modifications(words, at)
        depth = 0
        while at < len(words) and not (depth == 0 and words[at].text == ","):
            depth += (words[at].text in OPEN) - (words[at].text in CLOSE)
            at += 1
        at += 1


def _declarations(words: Sequence[Token]) -> Iterator[list[Token]]:
    """The statements of a class before its equations, without what stands between."""
    statement: list[Token] = []
    depth = 0
    for word in words[1:]:
        depth += (word.text in OPEN) - (word.text in CLOSE)
        if not statement and word.text in ("equation", "algorithm", "initial"):
            return
        if (not statement and word.kind == "text") or (
            not statement and word.text in ("public", "protected")
        ):
            continue
        if depth == 0 and word.text == ";":
            yield statement
            statement = []
        else:
            statement.append(word)


def _modifications(words: Sequence[Token], at: int) -> tuple[_Modification, ...]:
    """The modifications in the bracket at `at`, () if there is none. Redeclarations are left out."""
    if at >= len(words) or words[at].text != "(":
        return ()
    end = closing(words, at) - 1
    found: list[_Modification] = []
    at += 1
    while at < end:
        while at < end and words[at].text in ("each", "final"):
            at += 1
        if (
            at < end
            and words[at].kind == "name"
            and words[at].text not in ("redeclare", "replaceable", "break")
        ):
            first, name = words[at], words[at].text
            at += 1
            while at + 1 < end and words[at].text == ".":
                name, at = f"{name}.{words[at + 1].text}", at + 2
            found.append(_Modification(name, first, _modifications(words, at)))
        depth = 0
        while at < end and not (depth == 0 and words[at].text == ","):
            depth += (words[at].text in OPEN) - (words[at].text in CLOSE)
            at += 1
        at += 1
    return tuple(found)
