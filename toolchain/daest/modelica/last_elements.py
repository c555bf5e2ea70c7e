"""`end` as a subscript of an array of components, `connect(r[end].n, q)`, by the size of the array: the
compiler takes the first element."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from daest.modelica.components import Classes, Declared
from daest.modelica.nested_modifications import class_around, overwritten
from daest.modelica.outline import Edit, Token, arguments, class_heads, closing, edited, tokens

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
