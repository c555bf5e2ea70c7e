"""Equations and unknowns by component, for pictures of the structure of a model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")

CONNECTIONS = "connections"
TOP = "top level"


def component(origin: str) -> str:
    """The component that an equation belongs to; connections, between several, are one group."""
    return CONNECTIONS if "," in origin or not origin else origin


def owner(name: str) -> str:
    """The component that an unknown belongs to."""
    return name.partition(".")[0] if "." in name else TOP


def grouped(groups: Sequence[str]) -> list[int]:
    """Indices ordered by the first appearance of their group."""
    first = {name: i for i, name in reversed(list(enumerate(groups)))}
    return sorted(range(len(groups)), key=lambda i: (first[groups[i]], i))


def stretches(values: Sequence[T]) -> list[tuple[T, int, int]]:
    """Runs of equal values: the value, first index, index after the last."""
    starts = [i for i in range(len(values)) if i == 0 or values[i] != values[i - 1]]
    return [(values[a], a, b) for a, b in zip(starts, [*starts[1:], len(values)], strict=True)]
