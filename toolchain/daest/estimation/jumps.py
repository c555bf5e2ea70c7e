"""Equations that jump with the state: derivatives say nothing about a jump, and no search could see one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import EstimationError
from daest.model.flat import FlatModel

POINTS = 5  # random points on each switching surface
NEWTON = 20  # steps onto it
NEAR, NEARER = 1e-5, 1e-8  # distances from it, in units of the random points; a jump is the same at both
KEPT = 0.5  # of the difference over NEAR that is left over NEARER, where there is a jump
SMALLEST = 1e-9  # jump of a residual that counts


def check_jumps(flat: FlatModel) -> None:
    """Error `identify-jump` for the first equation whose residual jumps where the unknowns pass some surface.

    Comparisons, sign, floor and ceil whose arguments contain unknowns are tried; those that only bend the
    equation (an absolute value, a limit) are left alone, and so are jumps in time or with an input.
    """
    unknowns = ca.vertcat(flat.derivatives, flat.xi)
    others = ca.vertcat(flat.u, flat.w, flat.time)
    expressions = ca.vertcat(flat.residual, flat.output_expressions)
    surfaces = [g for g in _switches(expressions) if ca.depends_on(g, unknowns)]
    if not surfaces:
        return
    residual = ca.Function("residual", [unknowns, others, flat.theta], [expressions])
    rng = np.random.default_rng(0)
    for g in surfaces:
        surface = ca.Function("surface", [unknowns, others, flat.theta], [g, ca.gradient(g, unknowns)])
        for _ in range(POINTS):
            v = rng.standard_normal(unknowns.numel())
            rest = np.abs(rng.standard_normal(others.numel()))
            rows = _jumping_rows(surface, residual, v, rest, flat.theta_values)
            if rows.size:
                raise _jump(flat, int(rows[0]))


def _jumping_rows(
    surface: ca.Function, residual: ca.Function, v: np.ndarray, rest: np.ndarray, theta: np.ndarray
) -> np.ndarray:
    """Rows of the residual that differ on both sides of the surface, however close."""
    for _ in range(NEWTON):
        g, slope = (np.array(part).ravel() for part in surface(v, rest, theta))
        size = float(slope @ slope)
        if not np.isfinite(size) or size == 0.0:
            return np.zeros(0, dtype=int)
        v = v - g[0] * slope / size
    across = slope / np.sqrt(size)

    def difference(distance: float) -> np.ndarray:
        sides = [np.array(residual(v + s * distance * across, rest, theta)).ravel() for s in (1.0, -1.0)]
        return np.abs(sides[0] - sides[1])

    near, nearer = difference(NEAR), difference(NEARER)
    return np.flatnonzero((nearer > SMALLEST) & (nearer > KEPT * near))


def _switches(expressions: ca.SX) -> Iterator[Any]:
    """Scalar expressions whose zeros may be jumps of `expressions`."""
    stack: list[Any] = list(expressions.elements())
    seen = set()
    while stack:
        node = stack.pop()
        if node.element_hash() in seen:
            continue
        seen.add(node.element_hash())
        inner = [node.dep(i) for i in range(node.n_dep())]
        stack += inner
        operation = node.op() if inner else None
        if operation == ca.OP_SIGN:
            yield inner[0]
        elif operation in (ca.OP_LT, ca.OP_LE):
            yield inner[0] - inner[1]
        elif operation in (ca.OP_FLOOR, ca.OP_CEIL):
            yield ca.sin(np.pi * inner[0])


def _jump(flat: FlatModel, row: int) -> EstimationError:
    n = len(flat.equations)
    where = flat.equations[row].text if row < n else f"output {flat.outputs[row - n].name}"
    place = flat.equations[row].place if row < n else None
    return EstimationError(
        "identify-jump",
        f"`{where}` jumps as the model moves: no derivative tells how a parameter moves the moment of a jump",
        where=place,
        remedy="round the jump over a width that is small beside the motion, as tanh(w/width) for sign(w); "
        "the effects of the library are rounded",
    )
