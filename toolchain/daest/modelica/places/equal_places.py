"""Places that are the same in equal parts of a model: the nodes of `cell[1:4]`, all `T[i]` of a layered wall.

What acts on one of equal parts, as the heat that a pipe loses, acts on all of them: one law at each, with
parameters that all share.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daest.model.effects import Site, SiteKind
from daest.model.flat import FlatModel

EACH = "each "  # begins the name of the places together
_KINDS = ("node", "component", "pair", "connector", "equation", "exchange", "force", "mesh")
_SUBSCRIPTS = re.compile(r"\[([\d, ]+)\]")
_NUMBERED = re.compile(r"^([A-Za-z_]\w*?)(\d+)(?=\.|$)")  # a component and its number
_ROW = re.compile(r"^\d+:")  # before the name of a balance
_LETTERS = "ijklmn"
_Group = dict[tuple[SiteKind, str], Site]  # places by kind and name, each as the group calls it
_FURTHEST = 1  # elements between which something is exchanged: neighbours


def equal_places(flat: FlatModel, places: Sequence[Site]) -> list[Site]:
    """One place for all of `places` that differ in the subscripts of their names alone, or in the number
    behind the name of a component where the components have the same equations and values. A node is called
    by the first connector of many, in one part `wagon[1].a` and in the next one `wagon[2].b`: all of its
    connectors are its names here."""
    contents, groups = _Contents(flat), dict[object, _Group]()
    for site in places:
        for called in _by_all_names(site):
            key = _likeness(called) or _likeness_by_number(site, called, contents)
            if key is not None:
                groups.setdefault(key, {}).setdefault((site.kind, site.name), called)
    own = {(site.kind, site.name): site for site in places}
    return [_together(group, [own[key] for key in group]) for group in _whole(list(groups.values()))]


def _by_all_names(site: Site) -> list[Site]:
    """The place under its name, and a node under those of its other connectors besides."""
    others = site.connectors if site.kind == "node" else ()
    return [site, *(replace(site, name=name) for name in others if name != site.name)]


def _whole(groups: Sequence[_Group]) -> list[_Group]:
    """The groups of several places that are in no larger one; of those with the same places the one that
    calls most of them by their own names, the first of several."""
    best: dict[frozenset[tuple[SiteKind, str]], _Group] = {}
    for group in groups:
        known = best.get(frozenset(group))
        if len(group) > 1 and (known is None or _n_own_names(group) > _n_own_names(known)):
            best[frozenset(group)] = group
    return [group for places, group in best.items() if not any(places < other for other in best)]


def _n_own_names(group: _Group) -> int:
    return sum(name == called.name for (_, name), called in group.items())


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


def _likeness_by_number(site: Site, called: Site, contents: _Contents) -> tuple[object, ...] | None:
    """The same of places at components whose names end in numbers; None for others, and for a node by the
    connector of another component than it is called by: what else hangs there may be equal without it."""
    if called.name.partition(".")[0] != site.name.partition(".")[0]:
        return None
    parts = called.name.split(", ")
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


def _together(group: _Group, places: Sequence[Site]) -> Site:
    """The `places` of a group, called as in that, as one."""
    first = next(iter(group.values()))
    return Site(
        name=EACH + _pattern(first),
        kind="each",
        domain=first.domain,
        aliases=(_pattern(first),),
        is_grounded=all(site.is_grounded for site in places),
        parts=tuple(places),
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
