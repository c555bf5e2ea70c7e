"""Values of algebraic unknowns that agree with the start values of the differentiated ones."""

from __future__ import annotations

import casadi as ca
import numpy as np

from daest.model.flat import FlatModel

MAX_STEPS = 30
TOLERANCE = 1e-9
"""What an equation may leave, relative to the largest value of an unknown, at least 1."""

LARGEST = 2000
"""Up to this many algebraic unknowns the steps are computed, by dense least squares."""


def agreed_start(flat: FlatModel, xi: np.ndarray, u: np.ndarray, time: float, held: np.ndarray) -> np.ndarray:
    """ξ (n,) near `xi` that satisfies the equations without derivatives, at the parameters of the model.

    Unknowns that occur differentiated, and those that are `held` (bool, (n,)), stay as they are; the others
    change as little as possible (Gauss-Newton steps of least norm). Where that does not succeed, because the
    start values themselves contradict each other, `xi` is returned unchanged.
    """
    rates = ca.jacobian_sparsity(flat.residual, flat.derivatives)
    rows = np.setdiff1d(np.arange(flat.n), rates.row())
    free = np.setdiff1d(np.flatnonzero(~held), rates.get_col())
    if rows.size == 0 or free.size == 0 or free.size > LARGEST:
        return xi
    equations = flat.residual[rows.tolist()]
    arguments = [flat.xi, flat.u, flat.w, flat.theta, flat.time]
    slopes = ca.jacobian(equations, flat.xi[free.tolist()])
    evaluate = ca.Function("agreed", arguments, [equations, slopes])
    point = xi.copy()
    for _ in range(MAX_STEPS):
        residual, jacobian = (part.full() for part in evaluate(point, u, 0, flat.theta_values, time))
        if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(jacobian))):
            return xi
        if np.max(np.abs(residual)) <= TOLERANCE * max(1.0, float(np.max(np.abs(point)))):
            return point
        point[free] -= np.linalg.lstsq(jacobian, residual[:, 0], rcond=None)[0]
    return xi
