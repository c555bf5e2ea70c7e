"""Outputs that only name an expression: y = h(ξ, u, w, θ, t) instead of an unknown with an equation (report
(1b))."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.modelica.rows import Row


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
