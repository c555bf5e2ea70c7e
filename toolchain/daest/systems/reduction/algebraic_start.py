"""Values of algebraic unknowns that agree with the start values of the differentiated ones."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.model.flat import FlatModel

MAX_STEPS = 30
MAX_SWEEPS = 200
TOLERANCE = 1e-12
"""What an equation may leave, relative to the value that it is solved for, at least 1."""


def agreed_start(flat: FlatModel, xi: np.ndarray, u: np.ndarray, time: float, held: np.ndarray) -> np.ndarray:
    """ξ (n,) from `xi` with the algebraic unknowns that follow from others one by one, at the parameters of
    the model.

    Unknowns that occur differentiated, and those that are `held` (bool, (n,)), are known; an equation without
    derivatives that has one unknown left is solved for it, again and again. Where loops of unknowns are left,
    those with a start value of their own are taken to have that, and what follows from them is computed.
    """
    differentiated = ca.jacobian_sparsity(flat.residual, flat.derivatives).get_col()
    is_known = held.copy()
    is_known[differentiated] = True
    return _followed(flat, flat.residual, is_known, xi, u, flat.theta_values, time)[0]


def conditioned_start(
    flat: FlatModel, xi: np.ndarray, u: np.ndarray, theta: np.ndarray, time: float
) -> tuple[np.ndarray, np.ndarray]:
    """ξ (n,) from `xi`, with the unknowns that follow one by one from those with `fixed` and from the initial
    equations, and which of them are known now (bool, (n,)): as `agreed_start`, but no unknown is taken as
    known for being differentiated."""
    fixed = np.array([bool(v.fixed) for v in flat.unknowns], dtype=bool)
    conditions = ca.vertcat(flat.residual, flat.initial_residual)
    return _followed(flat, conditions, fixed, xi, u, theta, time)


def _followed(
    flat: FlatModel,
    conditions: ca.SX,
    is_known: np.ndarray,
    xi: np.ndarray,
    u: np.ndarray,
    theta: np.ndarray,
    time: float,
) -> tuple[np.ndarray, np.ndarray]:
    """What follows from the unknowns that are known by those of the `conditions` without derivatives, and
    what is known then."""
    is_open = np.ones(conditions.numel(), dtype=bool)
    is_open[ca.jacobian_sparsity(conditions, flat.derivatives).row()] = False
    slopes = ca.jacobian(conditions, flat.xi)
    arguments = [flat.derivatives, flat.xi, flat.u, flat.w, flat.theta, flat.time]
    evaluate = ca.Function("agreed", arguments, [conditions, slopes])
    entries = slopes.sparsity().get_triplet()
    numbered = (np.arange(1, slopes.nnz() + 1), tuple(np.array(part, dtype=int) for part in entries))
    pattern = sp.csr_array(numbered, shape=slopes.shape)  # of every entry its number, from 1
    point = xi.copy()
    declared = np.array([v.start is not None for v in flat.unknowns], dtype=bool)
    is_bent = _bent(slopes, flat.xi)
    for _ in range(MAX_SWEEPS):
        rows, columns = _single(pattern, is_open, is_known, is_bent)
        if rows.size == 0:
            if not np.any(declared & ~is_known):
                break
            is_known |= declared  # in loops of unknowns those with a start value of their own have that
            continue
        is_open[rows] = False
        numbers = np.asarray(pattern[rows, columns]).ravel() - 1
        solved = _solved(lambda x: evaluate(0, x, u, 0, theta, time), point, rows, columns, numbers)
        is_known[columns[solved]] = True
    return point, is_known


def _bent(slopes: ca.SX, unknowns: ca.SX) -> np.ndarray:
    """Of the entries of `slopes`, of equations by `unknowns`, whether they move with the unknown whose slope
    they are (bool, (n_entries,)): such an equation may have several solutions."""
    of_entry = np.array(slopes.sparsity().get_triplet()[1], dtype=int)
    moving = ca.jacobian_sparsity(slopes.nz[:], unknowns)
    entry, unknown = (np.array(part, dtype=int) for part in moving.get_triplet())
    is_bent = np.zeros(of_entry.size, dtype=bool)
    is_bent[entry[of_entry[entry] == unknown]] = True
    return is_bent


def _single(
    pattern: sp.csr_array, is_open: np.ndarray, is_known: np.ndarray, is_bent: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Open equations with one unknown that is not known, and that unknown: each unknown once. As long as some
    are straight in it, none that is bent: of a square both roots solve the equation, and which of them is
    meant, the others may tell."""
    entries = sp.coo_array(pattern)
    row, column = entries.coords
    kept = is_open[row] & ~is_known[column]
    row, column, bent = row[kept], column[kept], is_bent[entries.data[kept] - 1]
    alone = np.bincount(row, minlength=is_open.size)[row] == 1
    if np.any(alone & ~bent):
        alone &= ~bent
    columns, first = np.unique(column[alone], return_index=True)
    return row[alone][first], columns


def _solved(
    evaluate: Callable[[np.ndarray], tuple[ca.DM, ca.DM]],
    point: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    numbers: np.ndarray,
) -> np.ndarray:
    """Newton steps for row i in unknown columns[i], all at once, in place; which of them succeeded.
    numbers[i] is that of the slope of row i among those of `evaluate`."""
    before = point[columns].copy()
    for count in range(MAX_STEPS):
        residual, slopes = evaluate(point)
        value = residual.full()[rows, 0]
        slope = np.array(slopes.nonzeros())[numbers]
        is_done = np.abs(value) <= TOLERANCE * np.maximum(1.0, np.abs(slope * point[columns]))
        if count == 0:
            is_done = value == 0.0  # a small value, as 1e-14, is a value: at least one step is taken
        if np.all(is_done):
            break
        with np.errstate(all="ignore"):
            step = np.where(is_done, 0.0, value / slope)
        point[columns] -= np.where(np.isfinite(step), step, 0.0)
    point[columns] = np.where(is_done, point[columns], before)
    return np.asarray(is_done)
