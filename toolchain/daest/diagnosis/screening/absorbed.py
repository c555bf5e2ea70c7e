"""Effects that estimated parameters and unknown loads do already, whatever the recording: laws that only
rescale a model are told by its equations."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import casadi as ca
import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.screening.size_slopes import Sizes, sizes_of, slopes_over
from daest.model.flat import ExplicitModel
from daest.numerics.quiet import native_silence

_SEED = 20040101
_TRIES = 10  # points that are looked at, for each that is wanted


def rescaling_sizes(
    explicit: ExplicitModel,
    sizes: Sizes,
    estimated: Sequence[str],
    loads: Sequence[str],
    states: np.ndarray,
    inputs: np.ndarray,
    derivatives: np.ndarray,
) -> np.ndarray:
    """Which `sizes` (k,) of effects change the equations as constant changes of the `estimated`
    parameters and a scale of the `loads` do together: a gain at the input of a motor is the inverse of its
    inertia, friction and weight.

    `states` (n_samples, n), `inputs` (n_samples, n_u) and `derivatives` of inputs (n_samples, n_v) say
    where the machine works. The slopes ∂[f; h]/∂size of the rates and outputs are compared at as many points
    about there as tell all directions apart, where the loops of the model have a solution."""
    is_load = [i for i, name in enumerate(explicit.state_names) if name in loads]
    n_directions = len(estimated) + len(is_load)
    n_sizes = len(sizes.names)
    if not n_sizes or not n_directions:
        return np.zeros(n_sizes, dtype=bool)
    slopes = _slopes(explicit, sizes, estimated, is_load)
    rng = np.random.default_rng(_SEED)
    wanted = 4 * (n_directions + 1)
    tables: list[np.ndarray] = []
    for at in rng.integers(len(states), size=_TRIES * wanted):
        x, u, v = (
            values[at] * rng.uniform(0.5, 1.5, values.shape[1]) for values in (states, inputs, derivatives)
        )
        # A loop has no solution there: a pump against more than its own head.
        with suppress(RuntimeError), native_silence():
            tables.append(np.array(slopes(x, u, v, rng.uniform())))
        if len(tables) == wanted:
            break
    if len(tables) < wanted:
        return np.zeros(n_sizes, dtype=bool)
    whole = np.concatenate(tables)
    whole = whole[np.all(np.isfinite(whole), axis=1)]
    made, known = whole[:, :n_sizes], whole[:, n_sizes:]
    norms = np.linalg.norm(known, axis=0)
    basis = _basis(known[:, norms > 0.0] / norms[norms > 0.0])
    left = np.linalg.norm(made - basis @ (basis.T @ made), axis=0)
    before = np.linalg.norm(made, axis=0)
    return (before > 0.0) & (left < GATES.same_slopes * before)


def _slopes(
    explicit: ExplicitModel, sizes: Sizes, estimated: Sequence[str], is_load: Sequence[int]
) -> ca.Function:
    """(x, u, v, t) -> slopes of the rates and outputs over the sizes, over the `estimated` parameters and
    over a scale of the states `is_load`, whose own rows a scale leaves as they are."""
    n_x, n_u, n_v, n_w, n_theta = (explicit.rhs.numel_in(i) for i in range(5))
    x, u, v = ca.SX.sym("x", n_x), ca.SX.sym("u", n_u), ca.SX.sym("v", n_v)
    theta, t, w = ca.SX.sym("theta", n_theta), ca.SX.sym("t"), ca.SX.zeros(n_w)
    physical = [i for i in range(n_x) if i not in is_load]
    law = ca.vertcat(explicit.rhs(x, u, v, w, theta, t)[physical], explicit.outputs(x, u, v, w, theta, t))
    over_theta = [slopes_over(explicit, law, theta, s) for s in (sizes, sizes_of(explicit, estimated))]
    over_loads = ca.jacobian(law, x)[:, list(is_load)] @ ca.diag(x[list(is_load)])
    now = ca.substitute(over_loads, theta, ca.SX(explicit.flat.theta_values))
    return ca.Function("slopes", [x, u, v, t], [ca.densify(ca.horzcat(*over_theta, now))])


def _basis(table: np.ndarray) -> np.ndarray:
    """An orthonormal basis (m, r) of the columns of a table (m, d)."""
    left, values, _ = np.linalg.svd(table, full_matrices=False)
    return left[:, values > GATES.same_slopes * values[0]] if values.size else left
