"""Modifications of what a class does not have: `extends Motor(K = 3)` where it is called `k`.

The compiler checks the names of modifications where a component is declared, but neither those of an extends
clause nor those inside of another modification: it passes over them, and the model runs with other values.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import dropwhile

from daest.errors import ModelError
from daest.modelica.language import syntax as s
from daest.modelica.language.components import declared, statements
from daest.modelica.language.expressions import split_path
from daest.modelica.language.outline import (
    KINDS,
    ClassHead,
    Token,
    arguments,
    class_heads,
    class_tokens,
    depths,
    extends_clauses,
    find_base,
    name_end,
    place_of,
    tokens,
)
from daest.near import did_you_mean

_ATTRIBUTES = (
    *("start", "fixed", "min", "max", "nominal", "unit", "displayUnit", "quantity", "stateSelect"),
    *("unbounded", "absoluteValue"),
)


@dataclass(frozen=True)
class _Modification:
    """`name(inner) = …` at a token."""

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
            found = find_base(self.heads, head.name, base)
            own = None if found is None else names_of(self.text, self.heads, found)
            for one in modifications:
                self._check(one, "", own)
            if found is not None:
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


def check_redeclared_names(
    words: Sequence[Token], opening: int, base: ClassHead, heads: Sequence[ClassHead], text: bytes, file: str
) -> None:
    """As `check_class_modification`, of what a modification redeclares."""
    names = names_of(text, heads, base)
    for one in arguments(words, opening):
        at = redeclared_name(one)
        if names is not None and at is not None and at.text not in names:
            raise _nothing_there(_Modification(at.text, at, ()), f"`{base.name}`", sorted(names), text, file)


def redeclared_name(words: Sequence[Token]) -> Token | None:
    """The name of the class or component that an argument redeclares; None for any other argument."""
    if words[0].text != "redeclare":
        return None
    for i, word in enumerate(words):
        if word.text in KINDS and i + 1 < len(words):
            return words[i + 1]
        if word.text in ("(", "[", "=") or word.kind == "text":
            return words[i - 1]
    return words[-1]


def modified_names(text: bytes, class_name: str) -> frozenset[str]:
    """What a class gives its components by modifications, `motor.J` of `Inertia motor(J = 1)`."""
    head = next((one for one in class_heads(text) if one.name == class_name), None)
    if head is None:
        return frozenset()
    components = _components(class_tokens(text, head))
    return frozenset(f"{name}.{one.name}" for name, given in components for one in given)


def declared_records(text: bytes, class_name: str) -> frozenset[str]:
    """Components of a class whose types are records of its file."""
    heads = class_heads(text)
    head = next((one for one in heads if one.name == class_name), None)
    if head is None:
        return frozenset()
    inside = f"{head.name}.one"
    return frozenset(
        one.name.text
        for line in statements(class_tokens(text, head))
        for one in declared(line, head.name)
        if (of := find_base(heads, inside, one.type_name)) is not None and of.kind == "record"
    )


def names_of(text: bytes, heads: Sequence[ClassHead], head: ClassHead) -> frozenset[str] | None:
    """Names outside of brackets in a class and in those that it extends; None if one of them is in another
    file."""
    words = class_tokens(text, head)
    found = set(_outside(words))
    bases = [clause.base for clause in extends_clauses(words)]
    if head.is_short and len(words) > 2:
        bases = [words[2].text]
    for name in bases:
        base = find_base(heads, head.name, name)
        inherited = None if base is None else names_of(text, heads, base)
        if inherited is None:
            return None
        found |= inherited
    return frozenset(found)


def _nothing_there(
    one: _Modification, where: str, names: Sequence[str], text: bytes, file: str
) -> ModelError:
    hint = did_you_mean(one.name, names, 2)
    return ModelError(
        "model-unknown-name",
        f"{where} has no `{one.name}` that could be modified",
        where=place_of(file, text, one.at.start),
        remedy=f"{hint}Name something that it declares, or leave the modification out.",
    )


def _plain(name: str) -> str:
    return ".".join(ident for ident, _ in split_path(name))


def _outside(words: Sequence[Token]) -> Iterator[str]:
    """The names that stand outside of brackets."""
    return (words[i].text for i, depth in depths(words) if depth == 0 and words[i].kind == "name")


def _extensions(words: Sequence[Token]) -> Iterator[tuple[str, tuple[_Modification, ...]]]:
    """Base classes with the modifications of the clause."""
    for clause in extends_clauses(words):
        at = next(i for i, word in enumerate(words) if word.start == clause.start)
        yield clause.base, _modifications(words, name_end(words, at + 1))


def _components(words: Sequence[Token]) -> Iterator[tuple[str, tuple[_Modification, ...]]]:
    """Declared components that are modified."""
    for line in statements(words):
        for one in declared(line, ""):
            yield one.name.text, _modifications(one.modification, 0)


def _modifications(words: Sequence[Token], at: int) -> tuple[_Modification, ...]:
    """The modifications in the bracket at `at`, () if there is none. Redeclarations are left out."""
    if at >= len(words) or words[at].text != "(":
        return ()
    found: list[_Modification] = []
    for one in arguments(words, at):
        said = list(dropwhile(lambda word: word.text in ("each", "final"), one))
        end = name_end(said, 0)
        if end and said[0].text not in ("redeclare", "replaceable", "break"):
            name = "".join(word.text for word in said[:end])
            found.append(_Modification(name, said[0], _modifications(said, end)))
    return tuple(found)
