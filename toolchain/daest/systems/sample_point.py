"""A point near the start values at which the differentiated equations hold: where pivots are chosen."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import lsmr

from daest.systems.expand import ExpandedSystem
from daest.systems.sparse_jacobian import sparse_jacobian

MAX_STEPS = 25
TOLERANCE = 1e-10  # residual relative to the largest term of its linearisation, at which the search stops
GIVEN_WEIGHT = 1e-2  # a given start value moves this much less than one that the model leaves open
DENSE_LIMIT = 400  # equations up to which the least squares steps use a dense factorisation
NUDGE_SEED = 20041101


@dataclass(frozen=True)
class SamplePoint:
    """Values of the unknowns and their derivatives, `z` (n_levels, n), and of `ExpandedSystem.others`."""

    z: np.ndarray
    others: np.ndarray


def sample_point(system: ExpandedSystem) -> SamplePoint:
    """Start values (0 where none is given), moved by Gauss-Newton steps onto the equations if they are
    nonlinear.

    A model linear in everything but parameters needs no point: its Jacobian is the same everywhere. If the
    search does not arrive, the start values themselves are returned; the equations are then solved at
    initialisation."""
    start = np.zeros((len(system.z), system.z[0].numel()))
    start[0] = [0.0 if v.start is None else v.start for v in system.aliases.variables]
    point = SamplePoint(start, _other_values(system))
    unknowns = ca.vertcat(*system.z)
    jacobian = sparse_jacobian(system.residual, unknowns)
    if not ca.depends_on(jacobian, ca.vertcat(unknowns, *system.u, *system.w, system.flat.time)):
        return point
    moved = _project(ca.Function("F", [unknowns, system.others], [system.residual, jacobian]), system, point)
    return point if moved is None else moved


def nudged(point: SamplePoint) -> SamplePoint:
    """A generic point nearby, at which entries that vanish by accident of the start values do not vanish."""
    rng = np.random.default_rng(NUDGE_SEED)

    def nudge(values: np.ndarray) -> np.ndarray:
        return values + 0.1 * np.maximum(np.abs(values), 1.0) * rng.uniform(0.5, 1.0, values.shape)

    return SamplePoint(nudge(point.z), point.others)


def _other_values(system: ExpandedSystem) -> np.ndarray:
    inputs = [0.0 if v.start is None else v.start for v in system.flat.inputs]
    n_more = sum(symbols.numel() for symbols in (*system.u[1:], *system.w))
    return np.concatenate([inputs, np.zeros(n_more), system.flat.theta_values, [0.0]])


def _project(function: ca.Function, system: ExpandedSystem, point: SamplePoint) -> SamplePoint | None:
    z = point.z.ravel()
    weight = np.ones_like(point.z)
    weight[0, [v.start is not None for v in system.aliases.variables]] = GIVEN_WEIGHT
    for _ in range(MAX_STEPS):
        residual, slopes = function(z, point.others)
        value, jacobian = residual.full().ravel(), sp.csr_array(slopes.sparse())
        if not (np.all(np.isfinite(value)) and np.all(np.isfinite(jacobian.data))):
            return None
        size = np.maximum(abs(jacobian) @ np.maximum(np.abs(z), 1.0), np.finfo(float).tiny)
        if np.all(np.abs(value) <= TOLERANCE * size):
            return SamplePoint(z.reshape(point.z.shape), point.others)
        z = z + weight.ravel() * _least_squares(jacobian, weight.ravel(), -value)
    return None


def _least_squares(jacobian: sp.csr_array, weight: np.ndarray, right: np.ndarray) -> np.ndarray:
    scale = 1.0 / np.maximum(abs(jacobian).max(axis=1).toarray().ravel(), np.finfo(float).tiny)
    weighted = sp.csr_array(sp.diags_array(scale) @ jacobian @ sp.diags_array(weight))
    if right.size <= DENSE_LIMIT:
        return np.linalg.lstsq(weighted.toarray(), scale * right, rcond=None)[0]
    return lsmr(weighted, scale * right)[0]
