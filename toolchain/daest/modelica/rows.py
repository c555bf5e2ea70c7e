"""Flat equations, scalars or arrays, as scalar rows: residual `left - right` and the text of each row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.modelica import syntax as s
from daest.modelica import values as v
from daest.modelica.elements import Sizes, broadcast
from daest.modelica.expressions import Evaluator
from daest.modelica.functions import run_algorithm
from daest.modelica.reading import Reading
from daest.modelica.scope import element_names
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
    """The scalar rows of an equation, arrays row by row, records field by field. The texts show
    `substitutes` in place of the names that they stand for. Raises ModelError."""
    evaluator.at = equation.span
    known = {**substitutes, **{name: s.Constant(value) for name, value in equation.bound}}
    left_node = specialised(equation.left, known, evaluator.decided)
    right = s.Constant(0) if equation.right is None else equation.right
    right_node = specialised(right, known, evaluator.decided)
    if isinstance(left_node, s.Tuple):
        return _tuple_rows(equation, left_node, right_node, evaluator)
    a, b = evaluator.value(left_node), evaluator.value(right_node)
    residuals = _differences(a, b, evaluator)
    texts = _texts(left_node, right_node, a, b, len(residuals), _remembered(evaluator.size))
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


def algorithm_rows(algorithm: s.FlatAlgorithm, reading: Reading) -> list[Row]:
    """One row `variable - value` per scalar that an algorithm section assigns."""
    shapes = {variable.name: variable.dimensions for variable in reading.source.variables}
    evaluator = reading.evaluator(reading.scope, algorithm.span)
    library = reading.library(reading.scope)
    results = run_algorithm(algorithm, shapes, evaluator, library, reading.targets)
    made: list[Row] = []
    for name, value in results.items():
        if name in reading.targets:
            assert reading.events is not None
            reading.events.update(name, value)
            continue
        names = element_names(name, shapes.get(name, ()))
        residuals = _differences(evaluator.value(s.Name(name)), value, evaluator)
        equation = s.FlatEquation(s.Name(name), None, "component", algorithm.origin, algorithm.span)
        made += [
            Row(v.symbolic(r), f"{one} = (algorithm)", equation)
            for one, r in zip(names, residuals, strict=True)
        ]
    return made


# Texts ------------------------------------------------------------------------------------------------------


def _texts(left: s.Node, right: s.Node, a: Value, b: Value, count: int, size: Sizes) -> list[str]:
    """The text of each row; `a` and `b` are the values of both sides."""
    shapes = [value.shape for value in (a, b) if isinstance(value, np.ndarray)]
    if not shapes or count != np.prod(shapes[0]):
        return [_joined(left, right)] * count
    places = np.ndindex(*shapes[0])
    return [_joined(broadcast(left, at, size), broadcast(right, at, size)) for at in places]


def _remembered(size: Sizes) -> Sizes:
    """`size` evaluated once per node: every row of an array equation asks for the same nodes."""
    known: dict[int, tuple[s.Node, tuple[int, ...]]] = {}

    def remembered(node: s.Node) -> tuple[int, ...]:
        if id(node) not in known:
            known[id(node)] = (node, size(node))  # the node is kept, so that its id stays its own
        return known[id(node)][1]

    return remembered


def _joined(left: s.Node, right: s.Node) -> str:
    return f"{text(left)} = {text(right)}"
