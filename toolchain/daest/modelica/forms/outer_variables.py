"""Variables that a class declares as `outer`: each stands for the `inner` one of a component around it.

The compiler writes the `inner` variable in the equations of the class, and leaves the `outer` one without an
equation, or without a value.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from daest.modelica.language import syntax as s

_OUTER = re.compile(
    rb"(?P<both>\binner\s+)?\bouter(?:\s+(?:parameter|constant|discrete|replaceable|input|output|flow|stream))*\s*$"
)
_LONGEST = 100  # bytes of such prefixes


def without_outer_variables(source: s.FlatSource) -> s.FlatSource:
    """The source without `outer` variables that have an `inner` one, which stands in their places."""
    if not any(b"outer" in text for _, text in source.texts.values()):
        return source
    outer = {x.name for x in source.variables if _is_outer(x, source)}
    known = {x.name for x in source.variables} - outer
    meant = {name: inner for name in outer if (inner := _inner(name, known))}
    if not meant:
        return source
    kept = tuple(x for x in source.variables if x.name not in meant)
    short = replace(source, variables=kept)
    trees = ("variables", "equations", "initial_equations", "algorithms", "initial_algorithms", "whens")
    return replace(short, **{name: _named(getattr(short, name), meant) for name in trees})


def _is_outer(variable: s.FlatVariable, source: s.FlatSource) -> bool:
    at = variable.span
    if at is None or at.source not in source.texts:
        return False
    found = _OUTER.search(source.texts[at.source][1][max(0, at.start - _LONGEST) : at.start])
    return found is not None and found["both"] is None


def _inner(name: str, known: set[str]) -> str:
    """The variable of the same name in the nearest component around; empty if there is none."""
    *path, last = name.split(".")
    around = (".".join([*path[:end], last]) for end in range(len(path) - 1, -1, -1))
    return next((one for one in around if one in known), "")


def _named(tree: Any, meant: dict[str, str]) -> Any:
    """A tree with the names of `inner` variables."""
    made = s.rebuilt(tree, lambda part: _named(part, meant))
    return replace(made, name=meant[made.name]) if isinstance(made, s.Name) and made.name in meant else made
