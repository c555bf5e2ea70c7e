"""Flat equations, scalars or arrays, as scalar rows: residual `left - right` and the text of each row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.modelica import syntax as s
from daest.modelica import values as v
from daest.modelica.expressions import Evaluator
from daest.modelica.specialise import specialised
from daest.modelica.text import text
from daest.modelica.values import Record, Scalar, Value


@dataclass(frozen=True)
class Row:
    """One scalar equation; `residual` is left - right."""

    residual: ca.SX
    text: str
    equation: s.FlatEquation


def rows_of(equation: s.FlatEquation, evaluator: Evaluator, substitutes: Mapping[str, s.Node]) -> list[Row]:
    """The scalar rows of an equation, arrays row by row, records field by field. The texts show `substitutes` in
    place of the names that they stand for. Raises ModelError."""
    evaluator.at = equation.span
    known = {**substitutes, **{name: s.Constant(value) for name, value in equation.bound}}
    left_node = specialised(equation.left, known)
    right_node = s.Constant(0) if equation.right is None else specialised(equation.right, known)
    if isinstance(left_node, s.Tuple):
        return _tuple_rows(equation, left_node, right_node, evaluator)
    left, right = evaluator.value(left_node), evaluator.value(right_node)
    residuals = _differences(left, right, evaluator)
    texts = _texts(left_node, right_node, left, right, len(residuals), lambda node: _shape(evaluator, node))
    return [Row(v.symbolic(r), t, equation) for r, t in zip(residuals, texts, strict=True)]


def _tuple_rows(equation: s.FlatEquation, left: s.Tuple, right: s.Node, evaluator: Evaluator) -> list[Row]:
    shown = f"{text(left)} = {text(right)}"
    made: list[Row] = []
    for node, result in zip(left.elements, evaluator.results(right), strict=False):
        if node is not None:
            residuals = _differences(evaluator.value(node), result, evaluator)
            made.extend(Row(v.symbolic(r), shown, equation) for r in residuals)
    return made


def _differences(left: Value, right: Value, evaluator: Evaluator) -> list[Scalar]:
    if isinstance(left, Record) and isinstance(right, Record):
        pairs = [(value, right.fields[name]) for name, value in left.fields.items()]
        return [d for a, b in pairs for d in _differences(a, b, evaluator)]
    a, b = v.elements(left), v.elements(right)
    if len(a) != len(b) and 1 not in (len(a), len(b)):
        what = f"an equation has {len(a)} values on the left and {len(b)} on the right"
        raise evaluator.error("model-arithmetic", what, None, "Make the sizes of both sides equal.")
    count = max(len(a), len(b)) if a and b else 0
    return [v.subtract(a[i if len(a) > 1 else 0], b[i if len(b) > 1 else 0]) for i in range(count)]


# Texts ------------------------------------------------------------------------------------------------------

Sizes = Callable[[s.Node], tuple[int, ...]]


def _texts(left: s.Node, right: s.Node, a: Value, b: Value, count: int, size: Sizes) -> list[str]:
    """The text of each row; `a` and `b` are the values of both sides."""
    shapes = [value.shape for value in (a, b) if isinstance(value, np.ndarray)]
    if not shapes:
        return [_joined(left, right)] * count
    return [_joined(_broadcast(left, at, size), _broadcast(right, at, size)) for at in np.ndindex(*shapes[0])]


def _joined(left: s.Node, right: s.Node) -> str:
    return f"{text(left)} = {text(right)}"


def _shape(evaluator: Evaluator, node: s.Node) -> tuple[int, ...]:
    value = evaluator.value(node)
    return value.shape if isinstance(value, np.ndarray) else ()


_ELEMENTWISE = ("+", "-", ".+", ".-", ".*", "./", ".^")
_ELEMENTWISE_CALLS = ("der", "abs", "sign", "sqrt", "sin", "cos", "tan", "exp", "log", "tanh", "noEvent")


def element(node: s.Node, at: tuple[int, ...], size: Sizes) -> s.Node:
    """The node of element `at` (from 0) of an array expression, for its text: `{a, b}*k` at 1 -> `b*k`."""
    match node:
        case s.Array(elements, False) if len(elements) > at[0]:
            return element(elements[at[0]], at[1:], size) if len(at) > 1 else elements[at[0]]
        case s.Unary(operator, operand):
            return s.Unary(operator, element(operand, at, size))
        case s.Binary(operator, left, right) if operator in _ELEMENTWISE or _scales(node, size):
            return s.Binary(operator, _broadcast(left, at, size), _broadcast(right, at, size))
        case s.Call(function, (argument,), True) if function in _ELEMENTWISE_CALLS:
            return s.Call(function, (element(argument, at, size),), True)
        case s.Conditional(branches, otherwise):
            chosen = tuple((condition, _broadcast(value, at, size)) for condition, value in branches)
            return s.Conditional(chosen, _broadcast(otherwise, at, size))
        case s.Constant():
            return node
        case s.Name(name, ()):
            return s.Name(name, tuple(s.Constant(i + 1) for i in at))
    return s.Index(node, tuple(s.Constant(i + 1) for i in at))


def _scales(node: s.Binary, size: Sizes) -> bool:
    """A product with a scalar, or a quotient, goes element by element."""
    return node.operator in ("*", "/") and (size(node.left) == () or size(node.right) == ())


def _broadcast(node: s.Node, at: tuple[int, ...], size: Sizes) -> s.Node:
    return element(node, at, size) if size(node) else node
