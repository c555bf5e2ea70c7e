"""Flat equations, scalars or arrays, as scalar rows: residual `left - right` and the text of each row.

A connection equation comes from its connect clause. An output that only names an expression is y = h(ξ, u,
w, θ, t), no unknown with an equation (report (1b)). In the text of an expression known names are replaced,
subscripts computed and decided branches taken.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.errors import Place
from daest.modelica.flat.functions import run_algorithm
from daest.modelica.flat.reading import Reading
from daest.modelica.flat.scope import element_names
from daest.modelica.language import syntax as s
from daest.modelica.language import values as v
from daest.modelica.language.elements import Sizes, broadcast
from daest.modelica.language.expressions import Evaluator
from daest.modelica.language.outline import place_of
from daest.modelica.language.specialise import specialised
from daest.modelica.language.text import text
from daest.modelica.language.values import Record, Scalar, Value


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
            Row(_between_events(v.symbolic(r), reading), f"{one} = (algorithm)", equation)
            for one, r in zip(names, residuals, strict=True)
        ]
    return made


def _between_events(expression: ca.SX, reading: Reading) -> ca.SX:
    """No when-clause is active between events: what one assigns is its value before."""
    if reading.events is None or not reading.events.activations:
        return expression
    symbols = ca.vertcat(*[one.symbol for one in reading.events.activations])
    return ca.substitute(expression, symbols, ca.SX.zeros(symbols.numel()))


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


_CLAUSE = re.compile(rb"\bconnect\s*\(\s*([^,;()]+?)\s*,\s*([^,;()]+?)\s*\)")
_SUBSCRIPT = re.compile(r"\[[^\]]*\]|\s+")


class ConnectClauses:
    """The connect clauses of some files, found by the connectors that they name."""

    def __init__(self, texts: Iterable[tuple[str, bytes]]) -> None:
        self._found: dict[frozenset[str], tuple[str, bytes, int]] = {}
        for file, source in texts:
            for match in _CLAUSE.finditer(source):
                pair = frozenset(_plain(group.decode()) for group in match.groups())
                self._found.setdefault(pair, (file, source, match.start()))

    def place(self, connectors: tuple[str, ...]) -> Place | None:
        """The clause that connects two of `connectors` (names seen from the model), None if there is none.

        A connection between components of a component is written with shorter names there."""
        names = [_plain(name).split(".") for name in connectors]
        for i, left in enumerate(names):
            for right in names[i + 1 :]:
                found = self._clause(left, right)
                if found is not None:
                    return place_of(*found)
        return None

    def _clause(self, left: list[str], right: list[str]) -> tuple[str, bytes, int] | None:
        shared = 0
        while True:
            pair = frozenset((".".join(left[shared:]), ".".join(right[shared:])))
            if pair in self._found:
                return self._found[pair]
            if shared + 1 >= min(len(left), len(right)) or left[shared] != right[shared]:
                return None
            shared += 1


def _plain(name: str) -> str:
    return _SUBSCRIPT.sub("", name)


def used_texts(texts: Mapping[int, tuple[str, bytes]], sources: Iterable[int]) -> list[tuple[str, bytes]]:
    """The files that declare something of the model, once each."""
    return [texts[number] for number in dict.fromkeys(sources) if number in texts]


@dataclass(frozen=True)
class NamedOutput:
    """Unknown `unknown` is given by equation `row` as `expression`."""

    unknown: int
    row: int
    expression: ca.SX


def named_outputs(
    candidates: Sequence[int], rows: Sequence[Row], xi: ca.SX, derivatives: ca.SX
) -> list[NamedOutput]:
    """Those of the unknowns `candidates` (positions in xi) that occur, undifferentiated, in exactly one
    equation, with coefficient ±1, and whose expression holds no derivative. Each equation gives at most
    one."""
    if not candidates:
        return []
    residual = ca.vertcat(*[row.residual for row in rows])
    in_values = _incidence(residual, xi)
    in_derivatives = _incidence(residual, derivatives)
    found: list[NamedOutput] = []
    taken: set[int] = set()
    for unknown in candidates:
        at = in_values[unknown]
        if len(at) != 1 or in_derivatives[unknown] or at[0] in taken:
            continue
        expression = _solved(rows[at[0]].residual, xi[unknown], derivatives)
        if expression is not None:
            taken.add(at[0])
            found.append(NamedOutput(unknown, at[0], expression))
    return found


def _incidence(residual: ca.SX, variables: ca.SX) -> list[list[int]]:
    """Per variable the rows that it occurs in."""
    pattern = ca.jacobian_sparsity(residual, variables)
    rows, columns = np.array(pattern.row()), np.array(pattern.get_col())
    found: list[list[int]] = [[] for _ in range(variables.numel())]
    for row, column in zip(rows, columns, strict=True):
        found[column].append(int(row))
    return found


def _solved(residual: ca.SX, unknown: ca.SX, derivatives: ca.SX) -> ca.SX | None:
    """h with residual = ±(unknown - h), if h is free of derivatives."""
    coefficient = ca.jacobian(residual, unknown)
    if not (coefficient.is_one() or coefficient.is_minus_one()):
        return None
    rest = ca.substitute(residual, unknown, 0)
    expression = -rest if coefficient.is_one() else rest
    return None if ca.depends_on(expression, derivatives) else expression
