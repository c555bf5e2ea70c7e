"""Sizes and subscripts in the forms that the compiler takes.

- `end` as a subscript of an array of components, `connect(r[end].n, q)`, of which the compiler takes the
  first element: the size of the array is written.
- Integer constants of packages, `Real x[Sizes.n]`, which the compiler knows as no size: their numbers are.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from daest.modelica.forms.nested_modifications import class_around, overwritten
from daest.modelica.language.components import Classes, Declared, declared, statements
from daest.modelica.language.outline import (
    ClassHead,
    Edit,
    Token,
    arguments,
    class_heads,
    class_tokens,
    closing,
    edited,
    name_end,
    tokens,
)

_SUSPECT = re.compile(rb"\[[^\];]*\bend\b")


def with_last_elements(text: bytes, classes: Classes) -> bytes:
    """The text with sizes in place of `end` in the subscripts of what the classes declare with a size. Lines
    keep their numbers, and all else its column."""
    if not _SUSPECT.search(text):
        return text
    heads = class_heads(text)
    words = list(tokens(text))
    edits: list[Edit] = []
    for i, word in enumerate(words):
        if word.kind == "name" and words[i - 1].text != ".":
            edits += _of_name(words, i, class_around(heads, word.start), classes, text)
    return edited(text, edits)


def _of_name(words: Sequence[Token], at: int, scope: str, classes: Classes, text: bytes) -> Iterator[Edit]:
    """The edits of the subscripts of a name `a[i].b[end].c` that begins at a word."""
    around: str | None = scope
    path = ""
    while around is not None and at < len(words) and words[at].kind == "name":
        component = classes.component(words[at].text, around)
        behind = at + 1
        if behind < len(words) and words[behind].text == "[":
            behind = closing(words, behind)
            if component is not None:
                yield from _of_subscripts(words[at + 1 : behind], component, path, classes, text)
        path += text[words[at].start : words[behind - 1].end].decode() + "."
        around = None if component is None else classes.type_of(component)
        at = behind + 1 if behind < len(words) and words[behind].text == "." else len(words)


def _of_subscripts(
    words: Sequence[Token], component: Declared, path: str, classes: Classes, text: bytes
) -> Iterator[Edit]:
    for one, size in zip(arguments(words, 0), component.sizes, strict=False):
        if any(word.text == ":" for word in size):
            continue
        value = " ".join(_seen(word, component.scope, path, classes) for word in size)
        nested = [i for i, word in enumerate(one) if word.text == "["]
        for i, word in enumerate(one):
            inside = any(j < i < closing(one, j) for j in nested)
            if word.text == "end" and not inside:
                yield overwritten(text, word.start, word.end, value if len(size) == 1 else f"({value})")


def _seen(word: Token, scope: str, path: str, classes: Classes) -> str:
    """A word of a size as it is seen from outside of the component that declares it."""
    is_own = word.kind == "name" and classes.component(word.text, scope) is not None
    return f"{path}{word.text}" if is_own else word.text


def with_integer_constants(text: bytes, classes: Classes) -> bytes:
    """The text with the numbers of the Integer constants that its packages declare where other classes name
    them. Lines keep their numbers, and all else its column."""
    if b"package" not in text or b"Integer" not in text:
        return text
    heads = class_heads(text)
    numbers = dict(_numbers(text, heads))
    return edited(text, _edits(text, heads, numbers, classes)) if numbers else text


def _numbers(text: bytes, heads: Sequence[ClassHead]) -> Iterator[tuple[str, str]]:
    """Full names of the constants, with what they are. Those of a replaceable package may be others."""
    for head in heads:
        before = text[: head.start].split()
        if head.kind != "package" or head.is_short or b"replaceable" in before[-3:]:
            continue
        for line in statements(class_tokens(text, head)):
            if any(word.text == "constant" for word in line):
                for one in declared(line, head.name):
                    if one.type_name == "Integer" and [word.kind for word in one.binding] == ["number"]:
                        yield f"{head.name}.{one.name.text}", one.binding[0].text


def _edits(
    text: bytes, heads: Sequence[ClassHead], numbers: dict[str, str], classes: Classes
) -> Iterator[Edit]:
    last = {name.rpartition(".")[2] for name in numbers}
    words = list(tokens(text))
    at = 0
    while at < len(words):
        end = max(name_end(words, at), at + 1)
        if words[at].kind == "name" and words[end - 1].text in last:
            scope = class_around(heads, words[at].start)
            full = _full_name(words[at:end], scope, classes)
            is_named = end == at + 1 and end < len(words) and words[end].text == "="  # `f(n = 3)`
            if full in numbers and not is_named and not _is_import(words, at):
                yield overwritten(text, words[at].start, words[end - 1].end, numbers[full])
        at = end


def _is_import(words: Sequence[Token], at: int) -> bool:
    """Whether the name stands in an import clause."""
    return words[at - 1].text == "import" or (words[at - 1].text == "=" and words[at - 3].text == "import")


def _full_name(words: Sequence[Token], scope: str, classes: Classes) -> str:
    """What a name in a class means as that of a constant in a package; empty where it is another one."""
    *package, last = [word.text for word in words if word.text != "."]
    if classes.component((package or [last])[0], scope) is not None:
        return ""
    if package:
        found = classes.resolved(".".join(package), scope)
        return "" if found is None else f"{found}.{last}"
    around = classes.get(scope)
    return "" if around is None else around.imports.get(last, "")
