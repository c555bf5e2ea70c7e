"""Initial states that constraints tie together: what keeps a search over them from drifting off.

Every engine pulls a start onto the invariants of the model first, so that no output depends on the distance
from them. The squared distance is added to the objective: it is zero at the optimum, wherever that is, and
tells nothing about parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from daest.estimation.fitting.coordinates import Unknowns
from daest.estimation.fitting.search import Evaluation
from daest.model.flat import Dynamics

WEIGHT = 10.0  # of a distance by one state scale, as a whitened residual

Evaluate = Callable[[np.ndarray, bool], Evaluation | None]


@dataclass(frozen=True)
class Beginning:
    """A record's first sample: inputs (n_u,), input derivatives (n_v,) and time."""

    u: np.ndarray
    v: np.ndarray
    time: float


def with_ties(
    likelihood: Evaluate,
    explicit: Dynamics,
    unknowns: Unknowns,
    state_scale: np.ndarray,
    beginnings: Sequence[Beginning],
) -> Evaluate:
    """The objective plus the squared distances of the initial states from the invariants of the model; the
    objective itself where the model has none. Search vector: `unknowns`, then the initial state of every
    record in `state_scale`. Shapes: state_scale (n_states,)."""
    if explicit.invariants is None:
        return likelihood
    function, p, n = _invariants(explicit), len(unknowns.coordinates), state_scale.size
    parameters = unknowns.of_kind("parameter")
    columns = [unknowns.coordinates[i].index for i in parameters]

    def evaluate(z: np.ndarray, with_slopes: bool) -> Evaluation | None:
        here = likelihood(z, with_slopes)
        if here is None:
            return None
        theta, slopes = unknowns.values(z[:p])[0], unknowns.slopes(z[:p])[parameters]
        residuals, jacobian = [], np.zeros((len(beginnings) * n, z.size))
        for number, at in enumerate(beginnings):
            own = slice(number * n, (number + 1) * n)
            x0 = z[p:][own] * state_scale
            g, R, by_theta = (np.array(part) for part in function(x0, at.u, at.v, theta, at.time))
            scaled = R * state_scale
            gain = WEIGHT * np.linalg.pinv(scaled)
            residuals.append(gain @ g.ravel())
            jacobian[own, parameters] = gain @ by_theta[:, columns] * slopes
            jacobian[own, p + own.start : p + own.stop] = gain @ scaled
        distance = np.concatenate(residuals)
        if not np.all(np.isfinite(distance)):
            return None
        value = here.value + float(distance @ distance) / 2
        if not with_slopes:
            return Evaluation(value)
        return Evaluation(
            value, here.gradient + jacobian.T @ distance, here.information + jacobian.T @ jacobian
        )

    return evaluate


def _invariants(explicit: Dynamics) -> ca.Function:
    """(x, u, v, theta, t) -> g, ∂g/∂x, ∂g/∂θ, without noise."""
    assert explicit.invariants is not None
    x, u, v, w, theta, t = explicit.invariants.sx_in()
    g: Any = ca.substitute(explicit.invariants(x, u, v, w, theta, t), w, ca.SX.zeros(w.numel()))
    results = [g, ca.jacobian(g, x), ca.jacobian(g, theta)]
    return ca.Function("ties", [x, u, v, theta, t], [ca.densify(part) for part in results])
