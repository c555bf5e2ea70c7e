"""`redeclare Dry friction(c = 2);` among the declarations of a class, as part of its extends clause: the
compiler takes no other variable of the base class then that is bound to one of the component."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from daest.modelica.components import Classes, ClassText, statements
from daest.modelica.outline import (
    KINDS,
    Edit,
    Token,
    class_heads,
    edited,
    inserted,
    laid_over,
    name_end,
)


def with_redeclared_components(text: bytes, classes: Classes) -> bytes:
    """The text with the redeclared components of its classes in their extends clauses. Lines keep their
    numbers, and all else its column."""
    if b"redeclare" not in text:
        return text
    found = (classes.get(head.name) for head in class_heads(text) if not head.is_short)
    return edited(text, [edit for one in found if one is not None for edit in _moved(one, classes, text)])


def _moved(around: ClassText, classes: Classes, text: bytes) -> Iterator[Edit]:
    moved: dict[int, list[str]] = {}
    words = around.words
    for line in statements(words):
        if not line or line[0].text != "redeclare" or set(_texts(line[1:4])) & set(KINDS):
            continue
        end = next(
            (i for i, word in enumerate(line) if word.kind == "text" or word.text == "annotation"), len(line)
        )
        at = _base(line[:end], around, classes)
        if at is not None:
            moved.setdefault(at, []).append(" ".join(_texts(line[:end])))
            start, behind = line[0].start, words[words.index(line[-1]) + 1].end
            yield Edit(start, behind, laid_over(text[start:behind]).decode())
    for at, said in moved.items():
        name = name_end(words, at + 1)
        if words[name].text == "(":
            yield Edit(words[name].end, words[name].end, inserted(", ".join(said) + ", "))
        else:
            yield Edit(words[name - 1].end, words[name - 1].end, inserted(f"({', '.join(said)})"))


def _texts(words: Sequence[Token]) -> list[str]:
    return [word.text for word in words]


def _base(line: Sequence[Token], around: ClassText, classes: Classes) -> int | None:
    """Where among the words of a class the extends clause stands whose base has the component that a line
    redeclares."""
    outside = line[: next((i for i, word in enumerate(line) if word.text in ("(", "[", "=")), len(line))]
    for i, word in enumerate(around.words):
        if word.text == "extends":
            base = "".join(_texts(around.words[i + 1 : name_end(around.words, i + 1)]))
            scope = around.name.rpartition(".")[0]
            full = classes.resolved(base, scope) or classes.resolved(base, around.name)
            if full is not None and classes.component(outside[-1].text, full) is not None:
                return i
    return None
