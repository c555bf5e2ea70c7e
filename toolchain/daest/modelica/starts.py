"""Fixed start values that depend on parameters: `x(start = x0, fixed = true)` is the initial equation `x =
x0`."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from daest.modelica import syntax as s
from daest.modelica import values as v
from daest.modelica.metadata import is_fixed
from daest.modelica.reading import Reading
from daest.modelica.rows import Row
from daest.modelica.scope import Element
from daest.modelica.text import text


def start_rows(unknowns: Sequence[Element], reading: Reading) -> dict[str, Row]:
    """Per unknown with a fixed start value that is no number: the initial equation that says the same."""
    made: dict[str, Row] = {}
    for element in unknowns:
        node = element.variable.start
        if node is None or isinstance(node, s.Constant) or not is_fixed(element):
            continue
        found = v.elements(reading.evaluator(reading.scope, element.variable.span).value(node))
        value = v.constant(found[element.position if len(found) > 1 else 0])
        if isinstance(value, ca.SX):
            origin = element.variable.name.rpartition(".")[0]
            equation = s.FlatEquation(s.Name(element.name), node, "binding", origin, element.variable.span)
            made[element.name] = Row(element.symbol - value, f"{element.name} = {text(node)}", equation)
    return made
