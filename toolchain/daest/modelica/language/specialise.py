"""Expressions with names replaced by what they stand for, and conditions on constants decided."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from daest.modelica.language import syntax as s
from daest.modelica.language.expressions import RELATIONS

_ARITHMETIC = {"+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b}


# Whether a condition holds, None when that is not decided while the model is read.
Decide = Callable[[s.Node], bool | None]


def specialised(node: Any, known: Mapping[str, s.Node], decide: Decide) -> Any:
    """`x[i - 1]` with i = 3 -> `x[2]`; `if i > 1 then a else b` -> `a`. Conditions on constants are
    decided."""
    if isinstance(node, s.Name) and not node.subscripts and node.name in known:
        return known[node.name]
    if isinstance(node, s.Conditional):
        return _decided(node, known, decide)
    if isinstance(node, s.Comprehension):
        inner = {name: value for name, value in known.items() if name not in dict(node.iterators)}
        return s.rebuilt(node, lambda part: specialised(part, inner, lambda _: None))
    made = s.rebuilt(node, lambda part: specialised(part, known, decide))
    return _folded(made) if isinstance(made, s.Binary) else made


def with_numbers(equation: s.FlatEquation) -> s.FlatEquation:
    """The equation with numbers for the iterators of its loops."""
    if not equation.bound:
        return equation
    numbers = {name: s.Constant(value) for name, value in equation.bound}
    left = specialised(equation.left, numbers, lambda _: None)
    right = equation.right and specialised(equation.right, numbers, lambda _: None)
    return replace(equation, left=left, right=right, bound=())


def _decided(node: s.Conditional, known: Mapping[str, s.Node], decide: Decide) -> s.Node:
    open_branches: list[tuple[s.Node, s.Node]] = []
    for condition, value in node.branches:
        made = specialised(condition, known, decide)
        holds = made.value if isinstance(made, s.Constant) else decide(made)
        if holds is False:
            continue
        if holds is True:
            otherwise = specialised(value, known, decide)
            return s.Conditional(tuple(open_branches), otherwise, node.span) if open_branches else otherwise
        open_branches.append((made, specialised(value, known, decide)))
    otherwise = specialised(node.otherwise, known, decide)
    return s.Conditional(tuple(open_branches), otherwise, node.span) if open_branches else otherwise


def _folded(node: s.Binary) -> s.Node:
    """Whole-number arithmetic and relations of two constants."""
    left, right = node.left, node.right
    if not isinstance(left, s.Constant) or not isinstance(right, s.Constant):
        return node
    if not isinstance(left.value, int) or not isinstance(right.value, int):
        return node
    if node.operator in _ARITHMETIC:
        return s.Constant(_ARITHMETIC[node.operator](left.value, right.value), node.span)
    if node.operator in RELATIONS:
        return s.Constant(bool(RELATIONS[node.operator](left.value, right.value)), node.span)
    return node
