"""Replaceable classes that a component leaves as they are.

Where one component redeclares its package, the compiler gives that one to the other components of the class,
too; and a class that is redeclared in an extends clause it gives to the components inside of the heir. So
they redeclare the default, by another name: the same name changes nothing for the compiler.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from daest.modelica.components import MOST_BASES, Classes, ClassText, Declared, statements
from daest.modelica.nested_modifications import bases_of
from daest.modelica.outline import (
    KINDS,
    Edit,
    Token,
    arguments,
    class_heads,
    edited,
    inserted,
    name_end,
)

_PACKAGE = re.compile(rb"\bredeclare\s+(?:(?:final|each|replaceable)\s+)*package\s+([A-Za-z_]\w*)\s*=")
_ALIAS = "Default__{}"


def with_default_packages(text: bytes, classes: Classes) -> bytes:
    """The text with a redeclaration of each default that something else redeclares. Lines keep their numbers,
    and all else its column."""
    if b"redeclare" not in text:
        return text
    found = [classes.get(head.name) for head in class_heads(text)]
    every = [one for one in found if one is not None]
    wanted = {f"package {name.decode()}" for name in _PACKAGE.findall(text)}
    wanted |= {name for one in every for name in _redeclared_by(one)}
    aliases: dict[str, str] = {}  # kinds and full names -> what is redeclared
    components = [one for around in every for one in around.components.values() if wanted]
    edits = [edit for one in components for edit in _redeclared(one, wanted, classes, aliases)]
    appended = " ".join(f"{kind.split()[0]} {alias} = {kind.split()[1]};" for kind, alias in aliases.items())
    return edited(text, edits) + (f"\n{appended}\n".encode() if appended else b"")


def _redeclared_by(around: ClassText) -> set[str]:
    """Kinds and names of the classes that a class redeclares of those that it inherits."""
    every = [one for _, words in bases_of(around) if words for one in arguments(words, 0)]
    every += [] if around.alias else statements(around.words)
    return {_class(one) for one in every if one and one[0].text == "redeclare"} - {""}


def _redeclared(one: Declared, wanted: set[str], classes: Classes, aliases: dict[str, str]) -> Iterator[Edit]:
    """What is added to the modification of a component."""
    full = classes.resolved(one.type_name, one.scope)
    around = None if full is None else classes.get(full)
    defaults = {} if around is None else _defaults(around, classes)
    own = set(map(_class, arguments(one.modification, 0))) if one.modification else set()
    missing = [
        f"redeclare {name} = {aliases.setdefault(f'{name.split()[0]} {of}', _ALIAS.format(len(aliases)))}"
        for name, of in defaults.items()
        if of and name in wanted - own
    ]
    if missing and one.modification:
        comma = ", " if len(one.modification) > 2 else ""
        at = one.modification[0].end
        yield Edit(at, at, inserted(", ".join(missing) + comma))
    elif missing:
        yield Edit(one.behind, one.behind, inserted(f"({', '.join(missing)})"))


def _class(words: Sequence[Token]) -> str:
    """Kind and name of the class that an argument of a modification redeclares; empty for any other."""
    at = next((i for i, word in enumerate(words) if word.text in KINDS), len(words))
    return f"{words[at].text} {words[at + 1].text}" if at + 1 < len(words) else ""


def _defaults(around: ClassText, classes: Classes, steps: int = 0) -> dict[str, str]:
    """The replaceable classes of a class, with their kinds, and the full names of what they are; empty where
    that is modified."""
    found: dict[str, str] = {}
    for base, words in bases_of(around) if steps < MOST_BASES else ():
        full = classes.base(base, around.name)
        below = None if full is None or full == around.name else classes.get(full)
        found |= {} if below is None else _defaults(below, classes, steps + 1)
        for one in arguments(words, 0) if words else ():
            found |= _named(one, "redeclare", around, classes)
    for line in statements(around.words):
        found |= _named(line, "replaceable", around, classes) | _named(line, "redeclare", around, classes)
    return found


def _named(words: Sequence[Token], first: str, around: ClassText, classes: Classes) -> dict[str, str]:
    """What `redeclare model F = A` or the like says: the kind and the name, and the full name."""
    at = next((i for i, word in enumerate(words) if word.text in KINDS), len(words))
    if not words or words[0].text != first or at + 3 >= len(words) or words[at + 2].text != "=":
        return {}
    end = name_end(words, at + 3)
    full = classes.resolved("".join(word.text for word in words[at + 3 : end]), around.name)
    is_modified = end < len(words) and words[end].text == "("
    return {f"{words[at].text} {words[at + 1].text}": "" if full is None or is_modified else full}
