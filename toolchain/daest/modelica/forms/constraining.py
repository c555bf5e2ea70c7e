"""Constraining classes: `replaceable Linear law constrainedby Law(d = 0.4)`.

Their modifications belong to the class that is declared, and to any other in its place (Language
Specification 7.3.2). The compiler gives them to a component that is redeclared, but neither to the one that
is declared, nor to classes, `replaceable model Law = …`: there they are written once more.

A redeclared class may have all that the constraining class asks for and not extend it: Modelica asks for a
subtype (6.4), the compiler for a base class. Equal declarations may be inherited several times, so that such
a class extends the constraining one as well, `model M extends .Interface; …`. No line moves.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from daest.errors import ModelError
from daest.modelica.forms.modification_trees import Change, changes, merged, written
from daest.modelica.forms.modifications import check_redeclared_names
from daest.modelica.forms.nested_modifications import Modification, class_around, modifications, overwritten
from daest.modelica.language.components import MOST_BASES, Classes, ClassText
from daest.modelica.language.outline import (
    KINDS,
    ClassHead,
    Edit,
    Token,
    arguments,
    class_heads,
    closing,
    depths,
    edited,
    inserted,
    name_end,
    place_of,
    tokens,
)

_WORDS = ("true", "false")
_BEHIND = re.compile(rb'[A-Za-z_]\w*(?:\s*"(?:[^"\\]|\\.)*")?')


def with_constraining_modifications(text: bytes) -> bytes:
    """The text with the modifications of constraining classes in the declarations themselves, too."""
    if b"constrainedby" not in text:
        return text
    words = list(tokens(text))
    ends = [i for i, word in enumerate(words) if word.text == "constrainedby"]
    return edited(text, [edit for at in ends for edit in _added(text, words, at, _constraints(words, at))])


def with_constrained_redeclarations(text: bytes, path: Path, classes: Classes) -> bytes:
    """The text with the modifications of constraining classes of `classes` where these are redeclared. Raises
    ModelError for one that names a variable, which a class in another place cannot see, and for what is
    redeclared but not there."""
    if b"redeclare" not in text:
        return text
    heads = class_heads(text)
    edits: list[Edit] = []
    for one in modifications(list(tokens(text))):
        base = _modified_class(one, heads, classes)
        head = next((head for head in heads if base is not None and head.name == base.name), None)
        if base is not None and head is not None:
            check_redeclared_names(one.words, 0, head, heads, text, str(path))
            for words in arguments(one.words, 0):
                edits += _redeclared(words, base, classes, text, path)
    return edited(text, edits)


def with_common_bases(text: bytes, classes: Classes) -> bytes:
    """The text with a constraining class, the base class of the one that is declared, where a replaceable
    class has none and is redeclared with modifications: of two classes with one base the compiler takes each
    in place of the other, but not one that is modified."""
    words = list(tokens(text))
    names = {words[i + 2].text for i in _redeclarations(words)}
    heads = class_heads(text) if names else ()
    edits = []
    for i in _declarations(words):
        end = name_end(words, i + 4)
        behind = closing(words, end) if _text(words, end) == "(" else end
        if words[i + 2].text in names and _text(words, behind) != "constrainedby":
            name = "".join(word.text for word in words[i + 4 : end])
            bases = _bases_of(classes.resolved(name, class_around(heads, words[i].start)), classes)
            if len(bases) == 1:
                at = words[behind - 1].end
                edits.append(Edit(at, at, inserted(f" constrainedby {bases[0]}")))
    return edited(text, edits)


def _text(words: Sequence[Token], at: int) -> str:
    return words[at].text if at < len(words) else ""


def _redeclarations(words: Sequence[Token]) -> Iterator[int]:
    """Where classes are redeclared with modifications: `redeclare model F = Q(k = 3)`."""
    for i in range(len(words) - 5):
        at = i + (words[i + 1].text == "replaceable")
        is_class = words[at + 1].text in KINDS and words[at + 3].text == "="
        if words[i].text == "redeclare" and is_class and _text(words, name_end(words, at + 4)) == "(":
            yield at


def _declarations(words: Sequence[Token]) -> Iterator[int]:
    """Where classes are declared replaceable: `replaceable model F = A`."""
    for i in range(1, len(words) - 5):
        is_replaceable = words[i].text == "replaceable" and words[i - 1].text != "redeclare"
        if is_replaceable and words[i + 1].text in KINDS and words[i + 3].text == "=":
            yield i


def _bases_of(full: str | None, classes: Classes) -> list[str]:
    """Full names of the base classes of a class."""
    found = None if full is None else classes.get(full)
    if full is None or found is None:
        return []
    around = full.rpartition(".")[0]
    return [one for base in found.bases if (one := classes.resolved(base, around))]


def _constraints(words: Sequence[Token], at: int) -> tuple[Change, ...]:
    """What the constraining clause at a word modifies."""
    end = name_end(words, at + 1)
    return changes(words[end : closing(words, end)]) if end < len(words) and words[end].text == "(" else ()


def _added(text: bytes, words: Sequence[Token], behind: int, wanted: Sequence[Change]) -> Iterator[Edit]:
    """The modification in front of word `behind`, with what is `wanted` where it does not say so itself."""
    last = behind - 1
    while last > 0 and words[last].kind == "text":
        last -= 1
    opening = _opening(words, last) if words[last].text == ")" else last + 1
    if words[opening - 1].text == "annotation":
        return
    own = changes(words[opening : last + 1])
    every = merged((*wanted, *own))
    if len(every) == len(own) and all(one in own for one in every):
        return
    said = f"({', '.join(written(one, ('together', 'apart')) for one in every)})"
    yield overwritten(text, words[opening].start if own else words[last].end, words[last].end, said)


def _opening(words: Sequence[Token], closed: int) -> int:
    """The bracket that the one at `closed` closes."""
    before = range(closed, -1, -1)
    return next((i for i in before if words[i].text == "(" and closing(words, i) == closed + 1), 0)


def _modified_class(one: Modification, heads: Sequence[ClassHead], classes: Classes) -> ClassText | None:
    """The class that is extended, or that of the component that is declared."""
    scope = class_around(heads, one.words[0].start)
    if one.base:
        full = classes.base(one.base, scope)
        return classes.get(full) if full and full != scope else None
    named = next(
        one.head[i].text
        for i, depth in reversed([*depths(one.head)])
        if not depth and one.head[i].kind == "name"
    )
    component = classes.component(named, scope)
    full = None if component is None else classes.type_of(component)
    return None if full is None else classes.get(full)


def _redeclared(
    words: Sequence[Token], base: ClassText, classes: Classes, text: bytes, path: Path
) -> Iterator[Edit]:
    """What a redeclaration `redeclare model Law = Quadratic(…)` lacks."""
    at = next((i for i, word in enumerate(words) if word.text in KINDS), len(words))
    if words[0].text != "redeclare" or at + 3 >= len(words) or words[at + 2].text != "=":
        return
    wanted = _constraints_of(words[at + 1].text, base, classes)
    end = name_end(words, at + 3)
    end = closing(words, end) if end < len(words) and words[end].text == "(" else end
    for edit in _added(text, words, end, wanted):
        named = next((one for one in values_of(wanted) if names_variable(one)), None)
        if named is not None:
            raise ModelError(
                "model-unsupported",
                f"the constraining class of `{words[at + 1].text}` is modified with `{named}`, which a "
                "class in its place cannot see",
                where=place_of(str(path), text, words[0].start),
                remedy="Write the number there, or modify the components that are of this class.",
            )
        yield edit


def _constraints_of(name: str, around: ClassText, classes: Classes, steps: int = 0) -> tuple[Change, ...]:
    """What the constraining clause of class `name` modifies, which `around` declares or inherits."""
    own = classes.get(f"{around.name}.{name}")
    if own is not None:
        at = next((i for i, word in enumerate(own.words) if word.text == "constrainedby"), None)
        return () if at is None else _constraints(own.words, at)
    for base in [around.alias] if around.alias else around.bases:
        full = classes.base(base, around.name)
        below = None if full is None else classes.get(full)
        if below is not None and steps < MOST_BASES:
            found = _constraints_of(name, below, classes, steps + 1)
            if found:
                return found
    return ()


def values_of(every: Sequence[Change]) -> Iterator[str]:
    """All values in changes, and what stands behind redeclarations."""
    for one in every:
        yield one.value
        yield from values_of(one.inner)


def names_variable(value: str) -> bool:
    """Whether a value names something without a dot, which may be a variable, and not the like of `P.f`."""
    words = list(tokens(value.encode()))
    return any(
        word.kind == "name"
        and word.text not in _WORDS
        and "." not in [w.text for w in words[max(0, i - 1) : i + 2]]
        for i, word in enumerate(words)
    )


def fits(classes: Classes, name: str, wanted: str) -> bool:
    """Whether class `name` has a component for each one of class `wanted`, which is known."""
    return classes.get(wanted) is not None and all(
        classes.component(one, name) is not None for one in _components(classes, wanted)
    )


def _components(classes: Classes, name: str, steps: int = 0) -> set[str]:
    """The names of the components that a class declares or inherits."""
    found = classes.get(name)
    if found is None or steps > MOST_BASES:
        return set()
    bases = (classes.resolved(base, name.rpartition(".")[0]) for base in found.bases)
    return set(found.components).union(*(_components(classes, one, steps + 1) for one in bases if one))


def with_bases(text: bytes, bases: Mapping[str, str]) -> bytes:
    """The text in which each class of it that `bases` names extends another class, by full names."""
    edits = []
    heads = class_heads(text) if bases else ()
    for head in (head for head in heads if head.name in bases and not head.is_short):
        behind = _BEHIND.match(text, head.start)
        assert behind is not None
        edits.append(Edit(behind.end(), behind.end(), f" extends .{bases[head.name]};"))
    return edited(text, edits)
