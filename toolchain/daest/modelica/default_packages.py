"""Replaceable packages that a component leaves as they are.

Where one component redeclares its package, the compiler gives that one to the other components of the class,
too. So they redeclare the default, by another name: the same name changes nothing for the compiler.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from daest.modelica.components import Classes, ClassText, Declared
from daest.modelica.outline import Edit, Token, arguments, class_heads, edited, inserted, name_end

_REDECLARED = re.compile(rb"\bredeclare\s+(?:(?:final|replaceable)\s+)*package\s+([A-Za-z_]\w*)\s*=")
_ALIAS = "Default__{}"
_MOST_BASES = 30


def with_default_packages(text: bytes, classes: Classes) -> bytes:
    """The text with a redeclaration of each default package that some component redeclares. Lines keep their
    numbers, and all else its column."""
    names = {name.decode() for name in _REDECLARED.findall(text)}
    if not names:
        return text
    found = (classes.get(head.name) for head in class_heads(text) if not head.is_short)
    components = [one for around in found if around is not None for one in around.components.values()]
    aliases: dict[str, str] = {}  # full names -> what is redeclared
    edits = [edit for one in components for edit in _redeclared(one, names, classes, aliases)]
    appended = "".join(f" package {alias} = {full};" for full, alias in aliases.items())
    return edited(text, edits) + (f"\n{appended}\n".encode() if appended else b"")


def _redeclared(one: Declared, names: set[str], classes: Classes, aliases: dict[str, str]) -> Iterator[Edit]:
    """What is added to the modification of a component."""
    full = classes.type_of(one)
    around = None if full is None else classes.get(full)
    defaults = {} if around is None else _defaults(around, classes)
    own = {_package(words) for words in arguments(one.modification, 0)} if one.modification else set()
    missing = [
        f"redeclare package {name} = {aliases.setdefault(of, _ALIAS.format(len(aliases)))}"
        for name, of in defaults.items()
        if name in names - own
    ]
    if missing and one.modification:
        comma = ", " if len(one.modification) > 2 else ""
        at = one.modification[0].end
        yield Edit(at, at, inserted(", ".join(missing) + comma))
    elif missing:
        yield Edit(one.behind, one.behind, inserted(f"({', '.join(missing)})"))


def _package(words: list[Token]) -> str:
    """The package that an argument of a modification redeclares; empty for any other argument."""
    texts = [word.text for word in words]
    return texts[texts.index("package") + 1] if "package" in texts[:-1] and texts[0] == "redeclare" else ""


def _defaults(around: ClassText, classes: Classes, steps: int = 0) -> dict[str, str]:
    """The replaceable packages of a class, with the full names of what they are."""
    found: dict[str, str] = {}
    for base in around.bases if steps < _MOST_BASES else ():
        full = classes.resolved(base, around.name.rpartition(".")[0]) or classes.resolved(base, around.name)
        below = None if full is None else classes.get(full)
        found |= {} if below is None else _defaults(below, classes, steps + 1)
    words = around.words
    for i in range(len(words) - 4):
        if [word.text for word in words[i : i + 2]] == ["replaceable", "package"] and words[
            i + 3
        ].text == "=":
            end = name_end(words, i + 4)
            full = classes.resolved("".join(word.text for word in words[i + 4 : end]), around.name)
            if full is not None and words[end].text != "(":
                found[words[i + 2].text] = full
    return found
