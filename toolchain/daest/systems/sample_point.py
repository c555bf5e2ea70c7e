"""A point near the start values at which the differentiated equations hold: where pivots are chosen."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import lsmr

from daest.systems.algebraic_start import agreed_start
from daest.systems.expand import ExpandedSystem
from daest.systems.sparse_jacobian import sparse_jacobian

MAX_STEPS, MAX_HALVINGS = 25, 8
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
    """Start values, moved by Gauss-Newton steps onto the equations if they are nonlinear. Where none is
    given, it is the value that follows from the others one by one, else 0.

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
    point.z[0] = _agreed(system)
    moved = _project(ca.Function("F", [unknowns, system.others], [system.residual, jacobian]), system, point)
    return point if moved is None else moved


def _agreed(system: ExpandedSystem) -> np.ndarray:
    """Values (n,) of kept unknowns: given starts and what follows from them and the inputs, one by one."""
    flat, aliases = system.flat, system.aliases
    own = np.array([0.0 if v.start is None else v.start for v in aliases.variables])
    is_given = np.array([v.start is not None for v in aliases.variables], dtype=bool)
    u = np.array([0.0 if v.start is None else v.start for v in flat.inputs])
    xi = agreed_start(flat, aliases.sign * own[aliases.slot], u, 0.0, is_given[aliases.slot])
    values = xi[aliases.kept_unknowns]
    return np.where(is_given | ~np.isfinite(values), own, values)


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
    value, jacobian = _linearised(function, z, point.others)
    for _ in range(MAX_STEPS):
        if not _is_finite(value, jacobian):
            return None
        size = np.maximum(abs(jacobian) @ np.maximum(np.abs(z), 1.0), np.finfo(float).tiny)
        if np.all(np.abs(value) <= TOLERANCE * size):
            return SamplePoint(z.reshape(point.z.shape), point.others)
        step = weight.ravel() * _least_squares(jacobian, weight.ravel(), -value)
        for _ in range(MAX_HALVINGS):  # a step out of the domain of a root or a logarithm is too long
            value, jacobian = _linearised(function, z + step, point.others)
            if _is_finite(value, jacobian):
                break
            step = step / 2
        z = z + step
    return None


def _linearised(function: ca.Function, z: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, sp.csr_array]:
    residual, slopes = function(z, others)
    return residual.full().ravel(), sp.csr_array(slopes.sparse())


def _is_finite(value: np.ndarray, jacobian: sp.csr_array) -> bool:
    return bool(np.all(np.isfinite(value)) and np.all(np.isfinite(jacobian.data)))


def _least_squares(jacobian: sp.csr_array, weight: np.ndarray, right: np.ndarray) -> np.ndarray:
    scale = 1.0 / np.maximum(abs(jacobian).max(axis=1).toarray().ravel(), np.finfo(float).tiny)
    weighted = sp.csr_array(sp.diags_array(scale) @ jacobian @ sp.diags_array(weight))
    if right.size <= DENSE_LIMIT:
        return np.linalg.lstsq(weighted.toarray(), scale * right, rcond=None)[0]
    return lsmr(weighted, scale * right)[0]
