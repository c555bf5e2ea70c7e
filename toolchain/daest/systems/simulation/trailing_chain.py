"""A chain of states that nothing of a model feels, such as a dead time of a sensor, apart from the model.

A dead time at an output is ten linear states behind the machine: c' = A c + b w, where w is what the sensor
would show without it. Integrated with the machine, they ask for many short steps of all states and of all
their sensitivities. By themselves they are exact by the exponential of their matrix for every w that is a
polynomial over a sample interval: here the one through its values at the ends of the interval's PARTS. The
corrections of an observer act on both at the samples, between which nothing leads back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.linalg import expm

from daest.model.flat import ExplicitModel
from daest.systems.simulation.driven_chain import FEWEST, LOOKS, SAME, SEED, largest_chain
from daest.systems.simulation.sensor_laws import sensor_laws

PARTS = 4  # of a sample interval, at whose ends the signal is looked at


@dataclass(frozen=True, eq=False)
class TrailingChain:
    """The positions of the chain's states c (n_c,) and of the `rest` (n_r,) in x; `drive` is b (n_c,), its
    largest entry 1; `shown` (n_y, n_c) is what the outputs show of c. `matrix` is theta -> A (n_c, n_c),
    `slopes` theta -> its derivatives by all parameters, column-major (n_c², n_theta); `by` are the positions
    of those that it depends on. `model` is the rest, whose last output is w."""

    members: np.ndarray
    rest: np.ndarray
    drive: np.ndarray
    shown: np.ndarray
    matrix: ca.Function
    slopes: ca.Function
    by: tuple[int, ...]
    model: ExplicitModel


@dataclass(frozen=True)
class TrailingSteps:
    """c <- `transition` c + `drive` w over a sample interval, w (PARTS + 1,): (1 + n_by, n_c, n_c) and
    (1 + n_by, n_c, PARTS + 1), the first of both themselves, the others their derivatives."""

    transition: np.ndarray
    drive: np.ndarray


def trailing_chain(explicit: ExplicitModel) -> TrailingChain | None:
    """The largest chain of a model; None where it has none of FEWEST states or more, where its rates are no
    constant vector times one signal of the states of the rest, or where outputs bend what they show."""
    if not explicit.is_symbolic or explicit.n_states <= FEWEST or explicit.invariants is not None:
        return None
    if explicit.flat.events is not None or explicit.near is not None or sensor_laws(explicit) is not None:
        return None
    x, u, v, w, theta, t = explicit.rhs.sx_in()
    silent = ca.SX.zeros(w.shape)
    f, h = (part(x, u, v, silent, theta, t) for part in (explicit.rhs, explicit.outputs))
    members = largest_chain(f, x, is_felt=False)
    if members is None:
        return None
    at, rest = members.tolist(), np.setdiff1d(np.arange(explicit.n_states), members)
    own, ubar = f[at], ca.vertcat(u, v)
    A, shown = (ca.densify(ca.jacobian(one, x)[:, at]) for one in (own, h))
    others = ca.vertcat(x, ubar, t)
    if not rest.size or any(ca.which_depends(ca.vec(A), others, 1, True)):
        return None
    if any(ca.which_depends(ca.vec(shown), ca.vertcat(others, theta), 1, True)):
        return None
    alone = ca.substitute(ca.vertcat(own, h), x[at], ca.SX.zeros(len(at)))
    base, h = alone[: len(at)], alone[len(at) :]
    if any(ca.which_depends(base, ubar, 1, True)):
        return None
    drive = _direction(ca.Function("base", [x, theta, t], [ca.densify(base)]), explicit)
    if drive is None:
        return None
    signal = base[int(np.argmax(np.abs(drive)))]
    return TrailingChain(
        members,
        rest,
        drive,
        np.array(ca.evalf(shown)),
        ca.Function("chain", [theta], [A]),
        ca.Function("chain_slopes", [theta], [ca.densify(ca.jacobian(ca.vec(A), theta))]),
        tuple(sorted(set(ca.jacobian_sparsity(ca.vec(A), theta).get_triplet()[1]))),
        _model_of(explicit, rest, f, ca.vertcat(h, signal)),
    )


def _direction(base: ca.Function, explicit: ExplicitModel) -> np.ndarray | None:
    """The vector (n_c,), its largest entry 1, along which `base` lies wherever one looks; None where there is
    none."""
    rng, table = np.random.default_rng(SEED), []
    for size in 10.0 ** np.linspace(-3, 3, LOOKS):
        theta = explicit.flat.theta_values * rng.uniform(0.5, 1.5, base.numel_in(1))
        table.append(np.array(base(size * rng.uniform(-1.0, 1.0, base.numel_in(0)), theta, rng.uniform())))
    rows = np.concatenate([one.T for one in table])
    rows = rows[np.all(np.isfinite(rows), axis=1)]
    rows = rows[np.max(np.abs(rows), axis=1, initial=0.0) > 0.0]
    if not rows.shape[0]:
        return None
    largest = int(np.argmax(np.abs(rows[0])))
    if np.any(rows[:, largest] == 0.0):
        return None
    scaled = rows / rows[:, [largest]]
    return scaled[0] if np.all(np.abs(scaled - scaled[0]) <= SAME) else None


def _model_of(explicit: ExplicitModel, rest: np.ndarray, f: ca.SX, h: ca.SX) -> ExplicitModel:
    """The model of the states `rest` with the outputs h, of rates and outputs in the symbols of its `rhs`."""
    x, u, v, w, theta, t = explicit.rhs.sx_in()
    own = ca.SX.sym("x", rest.size)
    states = ca.SX.zeros(x.numel())
    states[rest.tolist()] = own
    at = [own, u, v, w, theta, t]
    rates, shown = ca.substitute([f[rest.tolist()], h], [x], [states])
    return replace(
        explicit,
        state_names=tuple(explicit.state_names[i] for i in rest),
        rhs=ca.Function("rhs", at, [ca.densify(rates)]),
        outputs=ca.Function("outputs", at, [ca.densify(shown)]),
    )


def trailing_steps(chain: TrailingChain, theta: np.ndarray, period: float) -> TrailingSteps:
    """For sample intervals of one length, the `period`; theta (n_theta,)."""
    A, changes = np.array(chain.matrix(theta)), np.array(chain.slopes(theta))
    n_c, p, points = A.shape[0], len(chain.by), PARTS + 1
    head = n_c * (1 + p)
    M = np.zeros((head + points,) * 2)
    for i in range(1 + p):
        rows = slice(i * n_c, (i + 1) * n_c)
        M[rows, rows] = A
        if i:
            M[rows, :n_c] = changes[:, chain.by[i - 1]].reshape(n_c, n_c, order="F")
    M[:n_c, head] = chain.drive
    powers = head + np.arange(PARTS)
    M[powers, powers + 1] = np.arange(1, points) / period
    made = expm(M * period)[:head].reshape(1 + p, n_c, -1)
    of_powers = np.linalg.inv(np.vander(np.arange(points) / PARTS, increasing=True))
    return TrailingSteps(
        np.ascontiguousarray(made[:, :, :n_c]), np.ascontiguousarray(made[:, :, head:] @ of_powers)
    )
