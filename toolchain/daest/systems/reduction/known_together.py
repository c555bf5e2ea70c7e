"""Parameters that the equations of a model know only together, as the mass and the weight of a falling body:
no recording tells them apart, whatever is measured of the states."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import casadi as ca
import numpy as np

from daest.model.flat import Dynamics
from daest.numerics.quiet import native_silence
from daest.systems.tolerances import SOLVER

MOST = 50  # parameters that are looked at: of more, the slopes of a large model take long
TRIES = 10  # points that are looked at, for each that is wanted
_SEED = 20040101


def told_apart(model: Dynamics, names: Sequence[str]) -> tuple[str, ...]:
    """The parameters of `names` without those that change the rates and outputs as constant changes of
    earlier ones do, in any state and under any input; all of them where that cannot be looked at."""
    slopes = _slopes(model, names) if 1 < len(names) <= MOST else None
    if slopes is None:
        return tuple(names)
    kept: list[str] = []
    basis = np.zeros((len(slopes), 0))
    for name, column in zip(names, slopes.T, strict=True):
        rest = column - basis @ (basis.T @ column)
        rest -= basis @ (basis.T @ rest)  # once more against rounding
        size, whole = np.linalg.norm(rest), np.linalg.norm(column)
        if whole > 0.0 and size <= SOLVER.known_together * whole:
            continue
        kept.append(name)
        if size > 0.0:
            basis = np.column_stack([basis, rest / size])
    return tuple(kept)


def _slopes(model: Dynamics, names: Sequence[str]) -> np.ndarray | None:
    """∂[f; h]/∂θ·θ (n_rows, n_names) at points anywhere, every row relative to its largest; None where too
    few of them can be evaluated."""
    theta0 = model.flat.theta_values
    at = [model.flat.parameter_names.index(name) for name in names]
    arguments = [ca.MX.sym(model.rhs.name_in(i), model.rhs.size_in(i)) for i in range(model.rhs.n_in())]
    both = ca.vertcat(model.rhs(*arguments), model.outputs(*arguments))
    table = ca.Function("slopes", arguments, [ca.jacobian(both, arguments[4])[:, at]])
    rng, wanted = np.random.default_rng(_SEED), 4 * (len(names) + 1)
    sizes = [table.numel_in(i) for i in range(table.n_in())]
    rows: list[np.ndarray] = []
    for _ in range(TRIES * wanted):
        point: list[np.ndarray] = [rng.uniform(0.1, 2.0, size) for size in sizes]
        point[4] = theta0
        with suppress(RuntimeError), native_silence():
            found = np.array(table(*point)) * theta0[at]
            if np.all(np.isfinite(found)):
                rows.append(found)
        if len(rows) == wanted:
            break
    if len(rows) < wanted:
        return None
    whole = np.concatenate(rows)
    largest = np.max(np.abs(whole), axis=1)
    return whole[largest > 0.0] / largest[largest > 0.0, None]
