"""Declared units that a connection contradicts."""

from __future__ import annotations

from collections.abc import Sequence

from daest.lists import first_few
from daest.model.flat import FlatModel
from daest.model.parts import Equation
from daest.quantities import converts, is_known_unit

MOST_NAMED = 3  # connections that a warning names


def contradictions(flat: FlatModel) -> tuple[str, ...]:
    """Connections that equate variables whose units no factor converts into each other, with the names and
    the line. Variables without a unit, and units that are not known, contradict nothing."""
    units = {y.name: y.unit for y in flat.outputs if y.unit}
    units |= {v.name: v.unit for v in (*flat.inputs, *flat.unknowns) if v.unit}
    found = []
    for equation in flat.equations:
        if equation.kind != "connection":
            continue
        left, _, right = equation.text.partition(" = ")
        if left in units and right in units and _contradict(units[left], units[right]):
            found.append(f"`{left}` [{units[left]}] with `{right}` [{units[right]}]{_where(equation)}")
    return tuple(dict.fromkeys(found))


def sentence(found: Sequence[str]) -> str:
    """The contradictions as one sentence."""
    return f"units contradict each other where the model connects {first_few(found, MOST_NAMED)}"


def _contradict(one: str, other: str) -> bool:
    if one == other or not (is_known_unit(one) and is_known_unit(other)):
        return False
    return not converts(one, other)


def _where(equation: Equation) -> str:
    return "" if equation.place is None else f" ({equation.place})"
