"""Redeclared classes that have all that the constraining class asks for, but do not extend it.

Modelica asks for a subtype (Language Specification 6.4), the compiler for a base class. Equal declarations
may be inherited several times, so that in the texts given to it such a class extends the constraining one as
well, `model M extends .Interface; …`. No line moves.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from daest.modelica.components import MOST_BASES, Classes
from daest.modelica.outline import Edit, class_heads, edited

_BEHIND = re.compile(rb'[A-Za-z_]\w*(?:\s*"(?:[^"\\]|\\.)*")?')


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
