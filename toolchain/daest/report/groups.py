"""Equations and unknowns by component, for pictures of the structure of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TypeVar

T = TypeVar("T")

CONNECTIONS = "connections"
TOP = "top level"


def component(origin: str, kind: str = "component") -> str:
    """The component that an equation of that `origin` and `kind` belongs to, also that of an unconnected
    connector; connections, between several, are one group, and so are the model's own equations."""
    if kind == "unconnected":
        origin = origin.rpartition(".")[0]
    return CONNECTIONS if "," in origin else origin or TOP


def owner(name: str) -> str:
    """The component that an unknown belongs to."""
    return name.partition(".")[0] if "." in name else TOP


def of_component(parameters: Mapping[str, T], name: str) -> dict[str, T]:
    """The parameters of component `name`, by their names in it."""
    prefix = f"{name}."
    return {n.removeprefix(prefix): p for n, p in parameters.items() if n.startswith(prefix)}


def grouped(groups: Sequence[str]) -> list[int]:
    """Indices ordered by the first appearance of their group."""
    first = {name: i for i, name in reversed(list(enumerate(groups)))}
    return sorted(range(len(groups)), key=lambda i: (first[groups[i]], i))


def stretches(values: Sequence[T]) -> list[tuple[T, int, int]]:
    """Runs of equal values: the value, first index, index after the last."""
    runs, start = [], 0
    for value, members in groupby(values):
        after = start + len(list(members))
        runs.append((value, start, after))
        start = after
    return runs
