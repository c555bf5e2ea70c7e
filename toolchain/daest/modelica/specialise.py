"""An expression under known values of for-iterators: names replaced, subscripts computed, decided branches taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from daest.modelica import syntax as s

_ARITHMETIC = {"+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b}
_RELATIONS = {
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b,
    "<>": lambda a, b: a != b,
}


def specialised(node: s.Node, iterators: Mapping[str, int]) -> s.Node:
    """`x[i - 1]` with i = 3 -> `x[2]`; `if i > 1 then a else b` -> `a`. Unchanged without iterators."""
    return _replaced(node, iterators) if iterators else node


def _replaced(node: Any, iterators: Mapping[str, int]) -> Any:
    if isinstance(node, tuple):
        return tuple(_replaced(part, iterators) for part in node)
    if not is_dataclass(node) or isinstance(node, s.Span | s.Constant):
        return node
    if isinstance(node, s.Name) and not node.subscripts and node.name in iterators:
        return s.Constant(iterators[node.name], node.span)
    if isinstance(node, s.Conditional):
        return _decided(node, iterators)
    if isinstance(node, s.Comprehension):
        inner = {name: _ for name, _ in iterators.items() if name not in dict(node.iterators)}
        return _rebuilt(node, inner)
    made = _rebuilt(node, iterators)
    return _folded(made) if isinstance(made, s.Binary) else made


def _rebuilt(node: Any, iterators: Mapping[str, int]) -> Any:
    return type(node)(*(_replaced(getattr(node, field.name), iterators) for field in fields(node)))


def _decided(node: s.Conditional, iterators: Mapping[str, int]) -> s.Node:
    open_branches = []
    for condition, value in node.branches:
        made = _replaced(condition, iterators)
        if isinstance(made, s.Constant) and made.value is False:
            continue
        if isinstance(made, s.Constant) and made.value is True:
            otherwise = _replaced(value, iterators)
            return s.Conditional(tuple(open_branches), otherwise, node.span) if open_branches else otherwise
        open_branches.append((made, _replaced(value, iterators)))
    otherwise = _replaced(node.otherwise, iterators)
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
    if node.operator in _RELATIONS:
        return s.Constant(_RELATIONS[node.operator](left.value, right.value), node.span)
    return node
