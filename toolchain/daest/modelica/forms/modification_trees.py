"""Modifications `(a(b = 1), c.d = 2, final e(min = 0) = 3)` as trees: read, laid over each other, written."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from daest.modelica.forms.array_values import taken_value
from daest.modelica.language import syntax as s
from daest.modelica.language.outline import Token, arguments, closing, name_end, tokens

Style = Literal["together", "apart", "packed"]
"""How an element with attributes and a value is written: `k(max = 5) = 4`; `k(max = 5), k = 4`; or as one
value, see `packed`."""

_PREFIXES = ("each", "final")
_OTHER = ("redeclare", "replaceable", "break")
_CODES = {"min": 7101, "max": 7102, "nominal": 7103, "start": 7104, "unit": 7105}
_UNUSED = ("displayUnit", "quantity")
_LETTERS = 6  # in a number that keeps them exactly


@dataclass(frozen=True)
class Change:
    """`prefixes name(inner) = value`; of a redeclaration, which has no name, `prefixes` are all words in
    front of the bracket, and `value` is what stands behind it."""

    name: str
    prefixes: tuple[str, ...]
    inner: tuple[Change, ...]
    value: str

    @property
    def both(self) -> bool:
        return bool(self.name and self.inner and self.value)


def changes(words: Sequence[Token]) -> tuple[Change, ...]:
    """The modifications in the bracket that opens at the first of `words`, one for each element; () where
    there is none."""
    if not words or words[0].text != "(":
        return ()
    return merged(change(one) for one in arguments(words, 0))


def change(words: Sequence[Token]) -> Change:
    """One argument of a modification; `a.b = 1` is `a(b = 1)`."""
    if words[0].text in _OTHER or all(word.text in _PREFIXES for word in words):
        return _other(words)
    at = 0
    while words[at].text in _PREFIXES:
        at += 1
    end = name_end(words, at)
    names = [word.text for word in words[at:end] if word.text != "."]
    if not names or any(word.text in _OTHER for word in words[at:end]):
        return _other(words)
    behind = closing(words, end) if end < len(words) and words[end].text == "(" else end
    if behind < len(words) and words[behind].text != "=":
        return _other(words)
    prefixes = tuple(word.text for word in words[:at])
    inner = tuple(_prefixed(one, prefixes) for one in changes(words[end:behind]))
    value = taken_value(words[behind + 1 :])
    made = Change(names[-1], prefixes if value else (), inner, value)
    for name in names[-2::-1]:
        made = Change(name, (), (made,), "")
    return made


def _prefixed(one: Change, prefixes: tuple[str, ...]) -> Change:
    """A change with the prefixes of the one that it stands in: `each x(start = 1)` is `x(each start = 1)`."""
    if not one.name:
        return one
    own = tuple(dict.fromkeys((*prefixes, *one.prefixes))) if one.value else one.prefixes
    return replace(one, prefixes=own, inner=tuple(_prefixed(part, prefixes) for part in one.inner))


def _other(words: Sequence[Token]) -> Change:
    """A redeclaration or what else is no plain modification; the modification of the class is read."""
    at = next((i for i, word in enumerate(words) if word.text == "(" and _is_class(words[:i])), len(words))
    end = closing(words, at) if at < len(words) else at
    return Change("", (_joined(words[:at]),), changes(words[at:end]), _joined(words[end:]))


def _is_class(words: Sequence[Token]) -> bool:
    """Whether a bracket behind the words of a redeclaration modifies the class or the component."""
    return bool(words) and words[0].text != "break" and (words[-1].kind == "name" or words[-1].text == "]")


def _joined(words: Iterable[Token]) -> str:
    return " ".join(word.text.replace("\n", "\\n") for word in words)


def merged(every: Iterable[Change]) -> tuple[Change, ...]:
    """One change for each element, in the order of their first ones."""
    found: dict[str | int, Change] = {}
    for i, one in enumerate(every):
        key = one.name or i
        found[key] = over(found[key], one) if key in found else one
    return tuple(found.values())


def over(below: Change, above: Change) -> Change:
    """What two changes of the same element make, where `above` counts if both say the same."""
    if not (below.name and above.name):
        return above
    prefixes, value = (above.prefixes, above.value) if above.value else (below.prefixes, below.value)
    if not value:
        prefixes = above.prefixes or below.prefixes
    return replace(above, prefixes=prefixes, value=value, inner=merged((*below.inner, *above.inner)))


def written(one: Change, styles: Sequence[Style], real: Container[str] = ()) -> str:
    """A change as text; `styles` are those of this level and of the levels inside. Only values of `real`
    elements, of the next level, are packed."""
    within = styles[1:] or styles
    prefix = "".join(f"{word} " for word in one.prefixes)
    inner = f"({', '.join(_part(part, within, real) for part in one.inner)})" if one.inner else ""
    if not one.name:
        return f"{prefix.rstrip()}{inner} {one.value}".rstrip()
    if not one.both or styles[0] == "together":
        return f"{prefix}{one.name}{inner}" + (f" = {one.value}" if one.value else "")
    return f"{prefix}{one.name}{inner}, {prefix}{one.name} = {one.value}"


def _part(one: Change, styles: Sequence[Style], real: Container[str]) -> str:
    value = packed(one) if styles[0] == "packed" and one.name in real and one.both else ""
    return (
        "".join(f"{word} " for word in one.prefixes) + f"{one.name} = {value}"
        if value
        else written(one, styles)
    )


def packed(one: Change) -> str:
    """Value and attributes in one expression that the compiler passes on as it is, `homotopy(homotopy(4, 5),
    7102)`, of arrays in each element; empty where that cannot be told."""
    inner = [attribute for attribute in one.inner if attribute.name not in _UNUSED]
    if any(attribute.name not in _CODES or attribute.inner for attribute in inner):
        return ""
    values = [one.value] if one.prefixes == ("each",) else _elements(one.value)
    for attribute in inner:
        if attribute.name == "unit":
            values = [_with_unit(value, attribute.value.strip('"')) for value in values]
            continue
        is_each = attribute.prefixes == ("each",)
        own = [attribute.value] * len(values) if is_each else _elements(attribute.value)
        if len(own) != len(values) or (
            is_each and one.prefixes != ("each",) and not one.value.startswith("{")
        ):
            return ""
        code = _CODES[attribute.name]
        pairs = zip(values, own, strict=True)
        values = [f"homotopy(homotopy({value}, {bound}), {code})" for value, bound in pairs]
    return f"{{{', '.join(values)}}}" if one.value.startswith("{") else values[0]


def _with_unit(value: str, unit: str) -> str:
    """A value packed with its unit, some letters in a number."""
    letters = unit.encode()
    for at in range(0, len(letters), _LETTERS):
        number = int.from_bytes(letters[at : at + _LETTERS], "big")
        value = f"homotopy(homotopy({value}, {number}.0), {_CODES['unit']})"
    return value


def _elements(value: str) -> list[str]:
    """The elements of an array that is written as such; the value itself of any other."""
    words = list(tokens(value.encode()))
    if not words or words[0].text != "{" or closing(words, 0) < len(words):
        return [value]
    return [_joined(one) for one in arguments(words, 0)]


def unpacked(node: s.Node | None) -> tuple[s.Node | None, dict[str, s.Node]]:
    """The value of a binding, and the attributes that `packed` has put into it."""
    if isinstance(node, s.Array):
        return _unpacked_array(node)
    attributes: dict[str, s.Node] = {}
    names = {code: name for name, code in _CODES.items()}
    while (
        isinstance(node, s.Call)
        and node.function == "homotopy"
        and isinstance(node.arguments[-1], s.Constant)
        and node.arguments[-1].value in names
        and isinstance(inner := node.arguments[0], s.Call)
        and inner.function == "homotopy"
    ):
        name, given = names[int(node.arguments[-1].value)], inner.arguments[1]
        if name == "unit":
            given = s.Constant(_letters(given) + _letters(attributes.get(name)))
        attributes[name] = given if name == "unit" else attributes.get(name, given)
        node = inner.arguments[0]
    return node, attributes


def _letters(node: s.Node | None) -> str:
    """The text of a constant, or the letters that are packed in a number."""
    if not isinstance(node, s.Constant):
        return ""
    if isinstance(node.value, str):
        return node.value
    number = int(node.value)
    return number.to_bytes((number.bit_length() + 7) // 8, "big").decode("utf-8", "replace")


def _unpacked_array(node: s.Array) -> tuple[s.Node, dict[str, s.Node]]:
    """As `unpacked`, of an array all of whose elements are packed."""
    every = [unpacked(element) for element in node.elements]
    names = set(every[0][1]) if every else set()
    if not names or any(set(given) != names for _, given in every):
        return node, {}
    made = replace(node, elements=tuple(value for value, _ in every if value is not None))
    first = every[0][1]
    arrays = {name: replace(node, elements=tuple(given[name] for _, given in every)) for name in names}
    return made, arrays | {name: first[name] for name in names & {"unit"}}
