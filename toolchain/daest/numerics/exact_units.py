"""The numbers of a pencil in whatever units: rows, columns and time rescaled until they are simple.

Units that are no simple fractions round every coefficient, and so break the coincidences that decide on the
index. They leave the products around cycles of the graph of rows and columns alone: one node after the other
gets the scale at which its entries towards the nodes before are integers, as small as there are.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from daest.numerics.exact_numbers import ULPS, simple_value

STEP = ULPS + 4.0
"""Roundings [eps/2] that a scale adds to the one it was told from: of the entry, and of three operations."""


ONE = Fraction(1)


@dataclass(frozen=True)
class Entry:
    """`value` · time^power at (row, column), value not zero."""

    row: int
    column: int
    value: float
    power: int


@dataclass(frozen=True)
class _Node:
    """The scale of a row or column, and how many roundings [eps/2] it may be wrong by."""

    scale: float
    ulps: float


def simple_in_other_units(entries: Sequence[Entry]) -> list[Fraction] | None:
    """The exact numbers of the entries, of comparable size as given, in units in which all of them are
    simple; None where there are no such units."""
    plain = _simple(entries)
    if plain is not None:
        return plain
    second = _time_unit(entries)
    if second is None:
        return None
    return _simple([Entry(e.row, e.column, e.value * second**e.power, e.power) for e in entries])


def _simple(entries: Sequence[Entry]) -> list[Fraction] | None:
    neighbours = _neighbours(entries)
    known: dict[tuple[str, int], _Node] = {}
    read: dict[int, Fraction] = {}
    for node in _in_order(neighbours):
        reached = [(k, known[other]) for k, other in neighbours[node] if other in known]
        found = _scaled(node, entries, reached, read)
        if found is None:
            return None
        known[node] = found
    return [read[k] for k in range(len(entries))]


def _neighbours(entries: Sequence[Entry]) -> dict[tuple[str, int], list[tuple[int, tuple[str, int]]]]:
    found: dict[tuple[str, int], list[tuple[int, tuple[str, int]]]] = {}
    for k, entry in enumerate(entries):
        row, column = ("row", entry.row), ("column", entry.column)
        found.setdefault(row, []).append((k, column))
        found.setdefault(column, []).append((k, row))
    return found


def _in_order(
    neighbours: dict[tuple[str, int], list[tuple[int, tuple[str, int]]]],
) -> list[tuple[str, int]]:
    """Every node after as many of its neighbours as can be; the first of a component has the most."""
    order: list[tuple[str, int]] = []
    done: set[tuple[str, int]] = set()
    links: dict[tuple[str, int], int] = {}
    starts = sorted(neighbours, key=lambda node: (-len(neighbours[node]), node))
    for start in starts:
        heap = [(0, 0, start)]
        while heap:
            count, _, node = heapq.heappop(heap)
            if node in done or (node in links and -count != links[node]):
                continue
            done.add(node)
            order.append(node)
            for _, other in neighbours[node]:
                if other not in done:
                    links[other] = links.get(other, 0) + 1
                    heapq.heappush(heap, (-links[other], len(order), other))
    return order


def _scaled(
    node: tuple[str, int],
    entries: Sequence[Entry],
    reached: Sequence[tuple[int, _Node]],
    read: dict[int, Fraction],
) -> _Node | None:
    """The scale at which the entries towards scaled nodes are the smallest integers, which go to `read`."""
    if not reached:
        return _Node(1.0, 0.0)
    reference, first = min(reached, key=lambda pair: pair[1].ulps)
    base = entries[reference].value * first.scale
    ratios: list[Fraction] = []
    for k, other in reached:
        wrong_by = first.ulps + other.ulps + 2 * STEP
        ratio = simple_value(entries[k].value * other.scale / base, wrong_by) if k != reference else ONE
        if ratio is None:
            return None
        ratios.append(ratio)
    common = Fraction(math.lcm(*(r.denominator for r in ratios)), math.gcd(*(r.numerator for r in ratios)))
    for (k, _), ratio in zip(reached, ratios, strict=True):
        read[k] = ratio * common
    return _Node(float(common) / base, first.ulps + STEP)


def _time_unit(entries: Sequence[Entry]) -> float | None:
    """The factor of time that makes the product around a short cycle with one derivative more on one of its
    sides one; None where every cycle is free of time."""
    neighbours = _neighbours(entries)
    scales: dict[tuple[str, int], tuple[float, int, int]] = {}  # scale, power of time, depth
    shortest: tuple[int, float] | None = None
    for start in sorted(neighbours, key=lambda node: (-len(neighbours[node]), node)):
        if start in scales:
            continue
        scales[start] = (1.0, 0, 0)
        queue = [start]
        for node in queue:
            scale, power, depth = scales[node]
            for k, other in neighbours[node]:
                value, own = scale * entries[k].value, power + entries[k].power
                if other not in scales:
                    scales[other] = (1.0 / value, -own, depth + 1)
                    queue.append(other)
                    continue
                product, exponent, length = scales[other]
                if abs(own + exponent) == 1 and (shortest is None or depth + length < shortest[0]):
                    shortest = depth + length, abs(value * product) ** (-1.0 / (own + exponent))
    return None if shortest is None else shortest[1]
