"""Members that connections give to expandable connectors (Language Specification 9.1.3), as declarations.

The compiler takes an expandable connector whose members are declared. In the texts given to it each connector
gets those that the connections of all texts name, `expandable connector Bus Real speed; …`: a signal as a
variable of its type, any other connector by its class. Where two expandable connectors of different classes
are connected, each gets the members of the other. No line moves.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from daest.modelica.language.components import Classes, ClassText
from daest.modelica.language.outline import Edit, class_heads, connect_clauses, edited

_HEAD = re.compile(rb'\bexpandable\s+connector\s+([A-Za-z_]\w*)\s*("(?:[^"\\]|\\.)*")?')
_SIGNALS = ("Real", "Integer", "Boolean", "String")

Members = dict[str, dict[str, str]]  # connector -> member -> type


def bus_members(classes: Classes, texts: Iterable[bytes]) -> Members:
    """The members that connections in the `texts`, of which `classes` knows the classes, give to the
    expandable connectors that these declare."""
    texts = list(texts)
    expandable = frozenset(name for text in texts for name in expandable_connectors(text))
    names = _names_of(texts, expandable)
    search = _Search(classes, expandable, names)
    for head in (head for text in texts if _connects(text, names) for head in class_heads(text)):
        found = classes.get(head.name)
        if found is not None:
            search.read(found)
    return search.shared()


def _names_of(texts: list[bytes], expandable: frozenset[str]) -> frozenset[str]:
    """The names of components that may be such connectors, by the last part of their types."""
    if not expandable:
        return frozenset()
    types = b"|".join({name.rpartition(".")[2].encode() for name in expandable})
    declared = re.compile(rb"\b(?:" + types + rb")\s+([A-Za-z_]\w*)")
    return frozenset(name.decode() for text in texts for name in declared.findall(text))


def _connects(text: bytes, names: frozenset[str]) -> bool:
    """Whether one of the names stands in a connect clause of the text."""
    some = b"|".join(name.encode() for name in names)
    return bool(names) and re.search(rb"\bconnect\s*\([^;()]*\b(?:" + some + rb")\b", text) is not None


def expandable_connectors(text: bytes) -> dict[str, int]:
    """Full names of the expandable connectors of a text, and where declarations may be added to each."""
    matches = list(_HEAD.finditer(text))
    by_start = {head.start: head.name for head in class_heads(text)} if matches else {}
    return {by_start[match.start(1)]: match.end() for match in matches if match.start(1) in by_start}


def with_members(text: bytes, members: Members) -> bytes:
    """The text with the members of its connectors declared behind their heads."""
    return edited(
        text,
        (
            Edit(
                end,
                end,
                "".join(f" {kind} {member};" for member, kind in sorted(members.get(name, {}).items())),
            )
            for name, end in expandable_connectors(text).items()
        ),
    )


@dataclass
class _Search:
    """What the connections of classes ask of expandable connectors; `names` are those of components that may
    be one."""

    classes: Classes
    expandable: frozenset[str]
    names: frozenset[str]
    members: Members = field(default_factory=dict)
    pairs: list[tuple[str, str]] = field(default_factory=list)

    def read(self, around: ClassText) -> None:
        for clause in connect_clauses(around.words):
            paths = [_path(clause.left), _path(clause.right)]
            if self.names.isdisjoint((*paths[0], *paths[1])):
                continue
            sides = [self._side(path, around.name) for path in paths]
            ends = [one for one in sides if one is not None]
            if len(ends) != 2:
                continue
            (first, second) = ends
            for (bus, member, kind), (_, _, other) in ((first, second), (second, first)):
                if bus in self.expandable and member and not kind and other:
                    self.members.setdefault(bus, {}).setdefault(member, self._declared_as(other))
            kinds = [kind for _, _, kind in ends]
            if kinds[0] != kinds[1] and {*kinds} <= self.expandable:
                self.pairs.append((kinds[0], kinds[1]))

    def _side(self, path: Sequence[str], scope: str) -> tuple[str, str, str] | None:
        """Of `a.b.c` the class of a.b, the name c and its class, empty where a.b has no such component; None
        where the path leads nowhere before that."""
        before, kind = "", scope
        for i, name in enumerate(path):
            one = self.classes.component(name, kind)
            if one is None:
                is_new = i == len(path) - 1 and kind in self.expandable
                return (kind, name, "") if is_new else None
            before, kind = kind, self.classes.meant(self.classes.type_of(one) or "")
        return before, path[-1], kind

    def _declared_as(self, kind: str) -> str:
        return kind if kind in _SIGNALS else f".{kind}"

    def shared(self) -> Members:
        """The members, those of connected connectors of different classes on both sides."""
        for _ in self.pairs:
            for one, other in self.pairs:
                both = {**self.members.get(one, {}), **self.members.get(other, {})}
                for name in (one, other):
                    self.members[name] = {
                        k: v for k, v in both.items() if self.classes.component(k, name) is None
                    }
        return self.members


def _path(argument: str) -> list[str]:
    """The names of `a.b[1].c`."""
    return re.sub(r"\[[^\]]*\]", "", argument).split(".")
