"""Places that are the same in equal parts of a model: the nodes of `cell[1:4]`, all `T[i]` of a layered wall.

What acts on one of equal parts, as the heat that a pipe loses, acts on all of them: one law at each, with
parameters that all share.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from daest.model.effects import Site
from daest.model.flat import FlatModel

EACH = "each "  # begins the name of the places together
_KINDS = ("node", "component", "pair", "connector", "equation", "exchange", "force", "mesh")
_SUBSCRIPTS = re.compile(r"\[([\d, ]+)\]")
_NUMBERED = re.compile(r"^([A-Za-z_]\w*?)(\d+)(?=\.|$)")  # a component and its number
_ROW = re.compile(r"^\d+:")  # before the name of a balance
_LETTERS = "ijklmn"
_FURTHEST = 1  # elements between which something is exchanged: neighbours


def equal_places(flat: FlatModel, places: Sequence[Site]) -> list[Site]:
    """One place for all of `places` that differ in the subscripts of their names alone, or in the number
    behind the name of a component where the components have the same equations and values."""
    contents, groups = _Contents(flat), dict[object, list[Site]]()
    for site in places:
        key = _likeness(site) or _likeness_by_number(site, contents)
        if key is not None:
            groups.setdefault(key, []).append(site)
    return [_together(group) for group in groups.values() if len(group) > 1]


def _likeness(site: Site) -> tuple[object, ...] | None:
    """What places in equal parts have in common; None for one that is in no array, and for one between
    elements that are no neighbours."""
    if site.kind not in _KINDS:
        return None
    parts = [_ROW.sub("", part) for part in site.name.split(", ")]
    indices = [_indices(part) for part in parts]
    if not any(indices):
        return None
    first = next(one for one in indices if one)
    apart: list[tuple[int, ...]] = []
    for one in indices:
        if len(one) == len(first):
            apart.append(tuple(b - a for a, b in zip(first, one, strict=True)))
        elif one:
            return None
    if any(np.abs(difference).sum() > _FURTHEST for difference in apart):
        return None
    pattern = ", ".join(_SUBSCRIPTS.sub("[]", part) for part in parts)
    return pattern, tuple(apart), site.kind, site.domain


def _without_number(part: str) -> str:
    return _NUMBERED.sub(r"\1#", part)


def _likeness_by_number(site: Site, contents: _Contents) -> tuple[object, ...] | None:
    """The same of places at components whose names end in numbers; None for others."""
    parts = site.name.split(", ")
    numbers = {found[2] for part in parts if (found := _NUMBERED.search(part))}
    if site.kind not in _KINDS or not site.connectors or len(numbers) != 1:
        return None
    owners = tuple(part.partition(".")[0] for part in parts)
    pattern = ", ".join(_without_number(part) for part in parts)
    return pattern, site.kind, site.domain, contents.of(owners)


def _indices(name: str) -> tuple[int, ...]:
    return tuple(int(i) for part in _SUBSCRIPTS.findall(name) for i in part.split(","))


class _Contents:
    """What components of a model are made of."""

    def __init__(self, flat: FlatModel) -> None:
        self.equations: dict[str, set[str]] = {}
        for equation in flat.equations:
            owner = equation.origin.partition(".")[0]
            if equation.kind in ("component", "binding") and owner:
                self.equations.setdefault(owner, set()).add(equation.text.replace(f"{owner}.", "."))
        self.values: dict[str, set[tuple[str, float]]] = {}
        for p in flat.parameters:
            owner, _, name = p.name.partition(".")
            self.values.setdefault(owner, set()).add((name, p.value))

    def of(self, components: Sequence[str]) -> tuple[object, ...]:
        """Equations and values of the components, without their names."""
        return tuple(
            (frozenset(self.equations.get(one, ())), frozenset(self.values.get(one, ())))
            for one in components
        )


def _together(group: Sequence[Site]) -> Site:
    """The places of a group as one."""
    first = group[0]
    return Site(
        name=EACH + _pattern(first),
        kind="each",
        domain=first.domain,
        aliases=(_pattern(first),),
        is_grounded=all(site.is_grounded for site in group),
        parts=tuple(group),
    )


def _pattern(site: Site) -> str:
    """The name of a place with letters for subscripts: `T[i], T[i+1]`, `wheel#.flange` of numbered ones."""
    parts = [_ROW.sub("", part) for part in site.name.split(", ")]
    first = next((one for part in parts if (one := _indices(part))), ())
    return ", ".join(_lettered(part, first) for part in parts)


def _lettered(part: str, first: Sequence[int]) -> str:
    if not first:
        return _without_number(part)
    letters = iter(zip(_LETTERS, first, strict=False))

    def subscripts(found: re.Match[str]) -> str:
        told = []
        for number in found[1].split(","):
            letter, begin = next(letters)
            further = int(number) - begin
            told.append(f"{letter}{further:+d}" if further else letter)
        return f"[{','.join(told)}]"

    return _SUBSCRIPTS.sub(subscripts, part)
