"""Outputs that bend the one motion that they show: a sensor of magnitude, one that cuts or has a dead zone.

The gain of an observer is that of a linear sensor. Where the sensor has lost the sign, an error has the
other sign; where it cuts, an error says nothing of the state. The gain is therefore designed for the largest
slope of the sensor, and follows the slope s at the predicted state, relative to that: x += K s(x) (y - h(x)).
An extended Kalman filter of constant covariance does the same where s is -1, 0 or 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from daest.model.flat import Dynamics, ExplicitModel
from daest.numerics.evaluator import along

MAGNITUDES = 10.0 ** np.arange(-6, 9)  # of the states, at which the slopes are looked at
DIRECTIONS = 4  # at each magnitude, both ways
SAME_SLOPE = 1e-2  # relative difference within which two slopes are one
FEWEST_ALIKE = 6  # looks at which a sensor has its largest slope; one that bends everywhere has it at fewer
SEED = 1


@dataclass(frozen=True)
class SensorLaws:
    """Of every output the state at which its sensor is looked at, (n,), or None where the output is no such
    sensor."""

    references: tuple[np.ndarray | None, ...]

    @property
    def key(self) -> tuple:
        """The same for laws that are the same."""
        return tuple(None if r is None else r.tobytes() for r in self.references)


def sensor_laws(explicit: Dynamics) -> SensorLaws | None:
    """The sensor laws of a model; None where it has none."""
    if not isinstance(explicit, ExplicitModel) or not explicit.is_symbolic or not explicit.n_states:
        return None
    x, u, v, w, theta, t = explicit.outputs.sx_in()
    h = explicit.outputs(x, u, v, w, theta, t)
    bends = ca.which_depends(h, x, 2, True)
    if not any(bends):
        return None
    slopes = ca.Function("slopes", [x, u, v, w, theta, t], [ca.densify(ca.jacobian(h, x))])
    n_y, n = h.numel(), explicit.n_states
    looks = _looks(n)
    at_rest = [np.zeros(explicit.outputs.numel_in(i)) for i in (1, 2, 3)]
    (columns,) = along(slopes, [looks, *at_rest, explicit.flat.theta_values, np.zeros(1)])
    table = np.ascontiguousarray(columns.reshape(-1, n, n_y).transpose(0, 2, 1))
    found = tuple(_reference(looks, table[:, j]) if is_bent else None for j, is_bent in enumerate(bends))
    return None if all(one is None for one in found) else SensorLaws(found)


def _looks(n: int) -> np.ndarray:
    """States (n_looks, n), from the smallest magnitude to the largest."""
    ways = np.random.default_rng(SEED).uniform(0.3, 1.0, (DIRECTIONS, n))
    ways *= np.random.default_rng(SEED + 1).choice([-1.0, 1.0], (DIRECTIONS, n))
    both = np.concatenate([ways, -ways])
    return np.concatenate([size * both for size in MAGNITUDES])


def _reference(looks: np.ndarray, slopes: np.ndarray) -> np.ndarray | None:
    """The middle one of the looks at which the slopes (n_looks, n) are largest; None where they do not lie
    along one direction, or have no largest value."""
    known = np.all(np.isfinite(slopes), axis=1)
    looks, slopes = looks[known], slopes[known]
    sizes = np.linalg.norm(slopes, axis=1)
    largest = sizes.max(initial=0.0)
    steep = np.flatnonzero(sizes > (1.0 - SAME_SLOPE) * largest)
    if not largest > 0.0 or steep.size < FEWEST_ALIKE:
        return None
    middle = steep[steep.size // 2]
    direction = slopes[middle] / sizes[middle]
    shares = slopes @ direction
    if np.any(np.linalg.norm(slopes - shares[:, None] * direction, axis=1) > SAME_SLOPE * largest):
        return None
    return looks[middle]


def relative_slopes(explicit: ExplicitModel, laws: SensorLaws, at: tuple[Any, ...]) -> tuple[Any, Any]:
    """s (n_y), the slopes of all sensors relative to those at the references, and the latter (n_y, n), at the
    symbols `at` = (x, u, v, w, theta, t). 1 and the slope itself for an output that is no such sensor. A
    slope beyond that of the reference lessens the gain, as it does in the limit of a precise sensor."""
    x = at[0]
    h = explicit.outputs(*at)
    slope = ca.densify(ca.jacobian(h, x))
    results, steep = [], []
    for j, reference in enumerate(laws.references):
        row = slope[j, :]
        if reference is None:
            results.append(type(row)(1.0))
            steep.append(row)
            continue
        there = ca.substitute(row, x, type(row)(ca.DM(reference)))
        s = ca.mtimes(row, there.T) / ca.sumsqr(there)
        results.append(ca.if_else(ca.fabs(s) > 1.0, 1.0 / s, s))
        steep.append(there)
    return ca.vertcat(*results), ca.vertcat(*steep)


def slopes_along(
    explicit: Dynamics, theta: np.ndarray, time: np.ndarray, states: np.ndarray, ubar: np.ndarray
) -> np.ndarray:
    """s (n_samples, n_y) along states (n_samples, n) with inputs ū (n_samples, n_ū): ones without sensor
    laws."""
    laws = sensor_laws(explicit)
    if laws is None:
        return np.ones((time.size, len(explicit.flat.outputs)))
    return _along(explicit, laws, 0, theta, time, states, ubar)[:, :, 0]


def steepest_slopes(
    explicit: Dynamics,
    laws: SensorLaws,
    theta: np.ndarray,
    time: np.ndarray,
    states: np.ndarray,
    ubar: np.ndarray,
) -> np.ndarray:
    """∂h/∂x (n_y, n) of all outputs: of a sensor that bends at its reference, else the mean along states
    (n_samples, n) with inputs ū (n_samples, n_ū)."""
    return _along(explicit, laws, 1, theta, time, states, ubar).mean(axis=0)


def _along(
    explicit: Dynamics,
    laws: SensorLaws,
    which: int,
    theta: np.ndarray,
    time: np.ndarray,
    states: np.ndarray,
    ubar: np.ndarray,
) -> np.ndarray:
    """The first or second result of `relative_slopes` (n_samples, n_y, 1 or n)."""
    assert isinstance(explicit, ExplicitModel)
    x, u, v, w, parameters, t = explicit.outputs.sx_in()
    wanted = relative_slopes(explicit, laws, (x, u, v, ca.SX.zeros(w.shape), parameters, t))[which]
    function = ca.Function("sensors", [x, u, v, parameters, t], [ca.densify(wanted)])
    n, n_u = time.size, u.numel()
    rows = np.array(function.map(n)(states.T, ubar[:, :n_u].T, ubar[:, n_u:].T, ca.repmat(theta, 1, n), time))
    return rows.reshape(wanted.size1(), n, wanted.size2()).transpose(1, 0, 2)
