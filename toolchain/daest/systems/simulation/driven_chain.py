"""A chain of states that inputs alone drive, such as a dead time at an input, apart from the rest of a model.

A dead time is ten linear states whose rates are many times those of the machine behind it. Integrated with
that machine, they ask for many short steps of all states and of all their sensitivities; by themselves they
are exact by the exponential of their matrix, and all that the rest sees of them is one signal, w = κᵀ c. On
parts of each sample interval that signal is replaced by the straight line with the same integrals of w and
of w t. What it rings within a part, the rest, which is slower, takes no notice of: the state that it leaves
differs by the second moment of what the line leaves out, 1e-6 of the signal for a machine of twenty samples
per time constant.

The sensitivities of c along parameters and start values are such signals, too. They enter the rest as what
drives the sensitivities of its states, ∂f/∂w ds/dθ, beside ∂f/∂θ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from daest.model.flat import ExplicitModel
from daest.numerics.exponential import STRAIGHT, Nodes, nodes_of_periods, transition_integrals
from daest.numerics.recursions import linear_recursion, varying_recursion
from daest.systems.simulation.sensor_laws import relative_slopes, sensor_laws
from daest.systems.tolerances import SOLVER

FEWEST = 4  # states of a chain that are worth it
PARTS = 4  # of a sample interval, on each of which the signal is a straight line
LOOKS = 6  # points at which it is looked how the rest sees the chain
SAME = 1e-10  # relative to the largest slope, that of one signal by rounding
SEED = 1
MOST_KEPT = 256  # lengths of steps: the segments of a record take the same ones


@dataclass(frozen=True, eq=False)
class DrivenChain:
    """The positions of the chain's states c (n_c,) and of the `rest` (n_r,) in x. `seen` (n_c,) is κ. It
    `is_shown` where outputs show w at once; `alone` are the outputs that are states of the chain, each with
    the place of that in c. `matrices` is theta -> A (n_c, n_c), B (n_c, n_ū), b (n_c,) with
    ċ = A c + B ū + b, `slopes` theta -> their derivatives by all parameters, column-major (size, n_theta);
    `by` are the positions of the parameters that these depend on."""

    members: np.ndarray
    rest: np.ndarray
    seen: np.ndarray
    is_shown: bool
    alone: tuple[tuple[int, int], ...]
    matrices: ca.Function
    slopes: ca.Function
    by: tuple[int, ...]

    def driven(self, columns: Sequence[int]) -> list[int]:
        """The places in `columns`, positions of parameters, of those that the chain depends on."""
        return [place for place, column in enumerate(columns) if column in self.by]

    def n_signals(self, columns: Sequence[int]) -> int:
        """w and its sensitivities along the parameters in `columns` and along the start of the chain."""
        return 1 + len(self.driven(columns)) + self.members.size


def driven_chain(explicit: ExplicitModel) -> DrivenChain | None:
    """The largest chain of a model; None where it has none of FEWEST states or more, or where the rest sees
    more of it than one signal."""
    if not explicit.is_symbolic or explicit.n_states <= FEWEST or explicit.invariants is not None:
        return None
    if explicit.flat.events is not None or explicit.near is not None:
        return None
    x, u, v, w, theta, t = explicit.rhs.sx_in()
    ubar, silent = ca.vertcat(u, v), ca.SX.zeros(w.shape)
    f, h = (part(x, u, v, silent, theta, t) for part in (explicit.rhs, explicit.outputs))
    members = largest_chain(f, x, is_felt=True)
    if members is None:
        return None
    rest = np.setdiff1d(np.arange(explicit.n_states), members)
    own = f[members.tolist()]
    if not rest.size or any(ca.which_depends(own, ca.vertcat(x, ubar), 2, True)):
        return None
    A, B = ca.jacobian(own, x)[:, members.tolist()], ca.jacobian(own, ubar)
    b = ca.substitute(own, ca.vertcat(x, ubar), ca.SX.zeros(x.numel() + ubar.numel()))
    parts = [ca.densify(part) for part in (A, B, b)]
    every = ca.vertcat(*map(ca.vec, parts))
    if any(ca.which_depends(every, ca.vertcat(x, ubar, t), 1, True)):
        return None
    places = {x[int(member)].element_hash(): i for i, member in enumerate(members)}
    shown = [h[j].element_hash() for j in range(h.numel())]
    alone = tuple((j, places[one]) for j, one in enumerate(shown) if one in places)
    h = h[[j for j in range(h.numel()) if shown[j] not in places]]
    others = ca.vertcat(f[rest.tolist()], h)
    by_chain = ca.jacobian(others, x)[:, members.tolist()]
    seen = _seen(ca.Function("seen", [x, u, v, theta, t], [ca.densify(by_chain)]), explicit)
    if seen is None:
        return None
    pattern = ca.jacobian_sparsity(every, theta)
    return DrivenChain(
        members,
        rest,
        seen,
        any(ca.which_depends(h, x[members.tolist()], 1, True)),
        alone,
        ca.Function("chain", [theta], parts),
        ca.Function("chain_slopes", [theta], [ca.densify(ca.jacobian(every, theta))]),
        tuple(sorted(set(pattern.get_triplet()[1]))),
    )


def largest_chain(f: ca.SX, x: ca.SX, *, is_felt: bool) -> np.ndarray | None:
    """The positions (n_c,) of the most states that depend on each other and on no other state, if the others
    may feel them (`is_felt`); else of the most on which no other state depends. None below FEWEST. `f` (n,)
    are the rates of the states `x` (n,)."""
    rows, columns = ca.jacobian_sparsity(f, x).get_triplet()
    n = x.numel()
    graph = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    _, label = connected_components(graph, directed=True, connection="strong")
    between = [(r, c) for r, c in zip(rows, columns, strict=True) if label[r] != label[c]]
    joined = {int(label[r if is_felt else c]) for r, c in between}
    groups = [np.flatnonzero(label == one) for one in set(label.tolist()) - joined]
    most = max(groups, key=lambda group: group.size, default=np.zeros(0, dtype=int))
    return most if most.size >= FEWEST else None


def _seen(slopes: ca.Function, explicit: ExplicitModel) -> np.ndarray | None:
    """κ (n_c,), the largest number 1, where all `slopes` over the chain lie along it wherever one looks."""
    rng = np.random.default_rng(SEED)
    table = []
    for size in 10.0 ** np.linspace(-3, 3, LOOKS):
        at = [size * rng.uniform(-1.0, 1.0, slopes.numel_in(i)) for i in range(3)]
        theta = explicit.flat.theta_values * rng.uniform(0.5, 1.5, slopes.numel_in(3))
        table.append(np.array(slopes(*at, theta, rng.uniform())))
    rows = np.concatenate(table)
    rows = rows[np.all(np.isfinite(rows), axis=1)]
    largest = np.max(np.abs(rows), axis=1, initial=0.0)
    rows = rows[largest > 0.0] / largest[largest > 0.0, None]
    if not rows.size:
        return None
    first = rows[0] / rows[0][np.argmax(np.abs(rows[0]))]
    scaled = rows / rows[:, [int(np.argmax(np.abs(first)))]]
    return first if np.all(np.abs(scaled - first) <= SAME) else None


@dataclass(frozen=True)
class RestFunctions:
    """The functions of the rest of a model, as `integrate` names them, with zeros for the outputs that show
    the chain `alone`. Their inputs are ū, then the signals
    of the chain for the rates, and once more for the outputs where these show it; their chosen parameters are
    the names asked for, then the start values of the chain."""

    rate: ca.Function
    rhs: ca.Function
    sens: ca.Function
    out: ca.Function
    bend: ca.Function | None


def rest_functions(explicit: ExplicitModel, chain: DrivenChain, columns: Sequence[int]) -> RestFunctions:
    """For the parameters in `columns`, positions in theta."""
    n_u, n_v, n_w = (explicit.rhs.numel_in(i) for i in (1, 2, 3))
    n_c, n_ubar, n_signals = chain.members.size, n_u + n_v, chain.n_signals(columns)
    x, t = ca.SX.sym("x", chain.rest.size), ca.SX.sym("t")
    theta, chosen = ca.SX.sym("theta", len(explicit.flat.parameters)), ca.SX.sym("chosen", len(columns) + n_c)
    ubar = ca.SX.sym("u", n_ubar + n_signals * (2 if chain.is_shown else 1))
    whole = ca.SX(theta)
    for place, column in enumerate(columns):
        whole[column] = chosen[place]
    # Zero, with the derivatives by the chosen parameters that the sensitivities of the chain have to drive.
    by = [chosen[place] - theta[columns[place]] for place in chain.driven(columns)]
    apart = ca.vertcat(*by, *(chosen[len(columns) + i] for i in range(n_c)))

    def at(first: int) -> tuple[Any, ...]:
        signal = ubar[first] + ca.dot(apart, ubar[first + 1 : first + n_signals])
        states = ca.SX.zeros(explicit.n_states)
        states[chain.rest.tolist()] = x
        states[int(chain.members[np.argmax(np.abs(chain.seen))])] = signal
        return states, ubar[:n_u], ubar[n_u:n_ubar], ca.SX.zeros(n_w), whole, t

    rates, outputs = at(n_ubar), at(n_ubar + n_signals if chain.is_shown else n_ubar)
    f, h = explicit.rhs(*rates)[chain.rest.tolist()], explicit.outputs(*outputs)
    for j, _ in chain.alone:
        h[j] = 0.0
    results = {
        "daest_rate": [f],
        "daest_rhs": [f, ca.jacobian(f, x)],
        "daest_sens": [ca.jacobian(f, x), ca.jacobian(f, chosen)],
        "daest_out": [h, ca.jacobian(h, x), ca.jacobian(h, chosen)],
    }
    laws = sensor_laws(explicit)
    if laws is not None:
        arguments = explicit.outputs.sx_in()
        sensors = ca.Function("sensors", arguments, [relative_slopes(explicit, laws, tuple(arguments))[0]])
        s = sensors(*outputs)
        results["daest_bend"] = [s, ca.jacobian(s, x), ca.jacobian(s, chosen)]
    here = ca.vertcat(theta[list(columns)] if columns else ca.SX(0, 1), ca.SX.zeros(n_c))
    parts = {}
    for name, expressions in results.items():
        dense = list(map(ca.densify, expressions))
        inner = ca.Function(f"inner_{name}", [x, ubar, chosen, theta, t], dense)
        parts[name] = ca.Function(
            name, [x, ubar, theta, t], inner.call([x, ubar, here, theta, t], True, False)
        )
    rate, rhs, sens, out = (parts[f"daest_{name}"] for name in ("rate", "rhs", "sens", "out"))
    return RestFunctions(rate, rhs, sens, out, parts.get("daest_bend"))


@dataclass(frozen=True)
class Driving:
    """What a chain does over a record: its `states` (n_samples, n_c), with their `slopes` by parameters and
    by its start (n_signals - 1, n_samples, n_c); its signals, w first, then its sensitivities along
    parameters and along its start, at the two ends of every part of every interval, `start` and `end`
    (n_samples - 1, PARTS, n_signals), and at the samples, `sampled` (n_samples, n_signals). Slopes and
    sensitivities are zeros where they are not wanted."""

    states: np.ndarray
    slopes: np.ndarray
    start: np.ndarray
    end: np.ndarray
    sampled: np.ndarray


def driving(
    chain: DrivenChain,
    theta: np.ndarray,
    columns: Sequence[int],
    lengths: Sequence[np.ndarray],
    inputs: tuple[np.ndarray, np.ndarray, np.ndarray | None],
    starts: np.ndarray,
    with_slopes: bool = True,
) -> Driving:
    """From each of the `starts` (n_records, n_c) of the chain over a record with intervals of its `lengths`
    (n_intervals,) [s]. inputs: ū at the two ends of every interval, each (n_steps, n_ū) for all records one
    behind the other, and their bends (n_steps, 2, n_ū) or None. `columns`: positions of the parameters along
    which sensitivities are wanted."""
    by = tuple(columns[place] for place in chain.driven(columns))
    powers = _powers(inputs)
    n_steps, n_c, p = powers[0].shape[0], chain.members.size, len(by)
    every, head = _all_steps(chain, theta, by, lengths, len(powers)), n_c * (1 + p)
    behind = np.hstack([*powers, np.ones((n_steps, 1))])
    # The states first, then what they drive: their sensitivities.
    drive = every.applied("transition", behind, np.s_[:, head:])
    states = every.recursion(n_c, drive[None, :, :n_c], starts[None])[0]
    slopes, first = np.zeros((p + n_c, states.shape[0], n_c)), every.first
    if with_slopes:
        moved = np.zeros((p + n_c, n_steps, n_c))
        by_states = drive[:, n_c:] + every.applied("transition", states[first], np.s_[n_c:, :n_c])
        moved[:p] = by_states.reshape(n_steps, p, n_c).transpose(1, 0, 2)
        begun = np.vstack([np.zeros((p, n_c)), np.eye(n_c)])[:, None]
        slopes = every.recursion(n_c, moved, np.broadcast_to(begun, (p + n_c, *starts.shape)))
    ends = np.zeros((n_steps, 2 * PARTS, 1 + p + n_c))
    if with_slopes:
        z = np.hstack([states[first], *slopes[:p, first], behind])
        ends[:, :, : 1 + p] = every.applied("lines", z, np.s_[:, :]).reshape(n_steps, -1, 1 + p)
        ends[:, :, 1 + p :] = every.applied("signal", slopes[p:, first], np.s_[:, :n_c]).transpose(1, 2, 0)
    else:
        ends[:, :, 0] = every.applied("signal", states[first], np.s_[:, :n_c])
        ends[:, :, 0] += every.applied("signal", behind, np.s_[:, head:])
    sampled = np.vstack([(states @ chain.seen)[None], slopes @ chain.seen]).T
    return Driving(states, slopes, ends[:, ::2], ends[:, 1::2], sampled)


def _powers(inputs: tuple[np.ndarray, np.ndarray, np.ndarray | None]) -> list[np.ndarray]:
    """The coefficients of the inputs in powers of the part r of an interval, each (n_steps, n_ū)."""
    u0, u1, bent = inputs
    rise = u1 - u0
    if bent is None:
        return [u0, rise]
    return [u0, rise + bent[:, 0], bent[:, 1] - bent[:, 0], -bent[:, 1]]


@dataclass(frozen=True)
class _Steps:
    """Of ż = M z, z = (c, ∂c/∂θ of some parameters, coefficients of the inputs in powers of the part of an
    interval, 1), over an interval of one length: the rows of the `transition` (n_c (1 + p), n_z) that give c
    and ∂c/∂θ at its end, and the `lines` (2 PARTS (1 + p), n_z) from z at its start to w and to its
    sensitivities along parameters at the two ends of its parts, one after the other; those of w alone are the
    `signal` (2 PARTS, n_z)."""

    transition: np.ndarray
    lines: np.ndarray
    signal: np.ndarray


@dataclass(frozen=True)
class _AllSteps:
    """The steps of all records: for each of `groups`, of intervals of lengths near each other, those of its
    nodes. `first` (n_steps,) are the samples at which the intervals begin, of `n_samples`."""

    groups: tuple[tuple[Nodes, list[_Steps]], ...]
    first: np.ndarray
    n_samples: int

    @property
    def is_even(self) -> bool:
        """Whether all intervals are of one length."""
        return len(self.groups) == 1 and len(self.groups[0][1]) == 1

    @cached_property
    def records(self) -> np.ndarray:
        """The first step of every record but the first one, of those that have any."""
        return np.flatnonzero(np.diff(self.first) > 1) + 1

    def applied(self, name: str, rows: np.ndarray, part: tuple[slice, slice]) -> np.ndarray:
        """The `part` of the matrix `name` of every step times the `rows` (..., n_steps, n_columns), one for
        each step: (..., n_steps, n_rows)."""
        if self.is_even:
            return np.asarray(rows @ getattr(self.groups[0][1][0], name)[part].T)
        found = np.zeros((*rows.shape[:-1], getattr(self.groups[0][1][0], name)[part].shape[0]))
        for group, steps in self.groups:
            own = rows[..., group.at, :]
            terms = zip(group.weights.T, steps, strict=True)
            found[..., group.at, :] = sum(w[:, None] * (own @ getattr(one, name)[part].T) for w, one in terms)
        return found

    def recursion(self, n_c: int, drive: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """States (k, n_samples, n_c) of the chain, or of its sensitivities, from the `starts` (k, n_records,
        n_c) of all records with what drives them (k, n_steps, n_c)."""
        if self.is_even and self.records.size + 1 == starts.shape[1]:
            # One matrix for all: a small part of the time that one for every step takes.
            same = np.ascontiguousarray(self.groups[0][1][0].transition[:n_c, :n_c])
            parts = enumerate(np.split(drive, self.records, axis=1))
            return np.concatenate([linear_recursion(same, own, starts[:, i]) for i, own in parts], axis=1)
        # From the last sample of a record a step that forgets it leads to the start of the next.
        transitions, whole = (
            np.zeros((self.n_samples - 1, n_c, n_c)),
            np.empty_like(drive, shape=(drive.shape[0], self.n_samples - 1, n_c)),
        )
        for group, steps in self.groups:
            nodes = np.array([one.transition[:n_c, :n_c] for one in steps])
            transitions[self.first[group.at]] = np.tensordot(group.weights, nodes, 1)
        whole[:, self.first] = drive
        whole[:, np.setdiff1d(np.arange(self.n_samples - 1), self.first)] = starts[:, 1:]
        return varying_recursion(transitions, whole, starts[:, 0])


def _all_steps(
    chain: DrivenChain, theta: np.ndarray, by: tuple[int, ...], lengths: Sequence[np.ndarray], n_powers: int
) -> _AllSteps:
    A = np.array(chain.matrices(theta)[0])
    key, groups = theta.tobytes(), []
    for group in nodes_of_periods(A, np.concatenate(lengths), SOLVER.equal_steps):
        groups.append((group, [_steps(chain, key, by, node, n_powers) for node in group.nodes.tolist()]))
    before = np.repeat(np.arange(len(lengths)), [one.size for one in lengths])
    return _AllSteps(tuple(groups), np.arange(before.size) + before, before.size + len(lengths))


@lru_cache(maxsize=MOST_KEPT)
def _steps(chain: DrivenChain, theta: bytes, by: tuple[int, ...], period: float, n_powers: int) -> _Steps:
    at, length = np.frombuffer(theta), period / PARTS
    A, B, b = (np.array(part) for part in chain.matrices(at))
    n_c, n_u, p = A.shape[0], B.shape[1], len(by)
    changes = np.array(chain.slopes(at))[:, list(by)]
    dA, dB, db = np.split(changes, [n_c * n_c, n_c * n_c + n_c * n_u])
    head = n_c * (1 + p)
    M, looks = np.zeros((head + n_u * n_powers + 1,) * 2), np.zeros((1 + p, head + n_u * n_powers + 1))
    for i in range(1 + p):
        rows = slice(i * n_c, (i + 1) * n_c)
        looks[i, rows] = chain.seen
        M[rows, rows] = A
        if i:
            M[rows, :n_c] = dA[:, i - 1].reshape(n_c, n_c, order="F")
        M[rows, head : head + n_u] = B if not i else dB[:, i - 1].reshape(n_c, n_u, order="F")
        M[rows, -1] = b[:, 0] if not i else db[:, i - 1]
    for k in range(n_powers - 1):
        now = np.arange(head + k * n_u, head + (k + 1) * n_u)
        M[now, now + n_u] = (k + 1) / period
    step = transition_integrals(M, length, STRAIGHT, by_doubling=True)
    # The line with the mean m and the moment k about the middle of a part runs from m - 3 k to m + 3 k.
    ends = (
        looks
        @ np.array([6.0 * step.second - 2.0 * step.first, 4.0 * step.first - 6.0 * step.second])
        / length
    )
    lines = []
    for _ in range(PARTS):
        lines += list(ends)
        ends = ends @ step.transition
    table = np.array(lines)
    transition = np.ascontiguousarray(np.linalg.matrix_power(step.transition, PARTS)[:head])
    return _Steps(transition, table.reshape(-1, table.shape[2]), table[:, 0])


def parts_of_inputs(
    inputs: tuple[np.ndarray, np.ndarray, np.ndarray | None],
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Inputs, as those of `driving`, on every part of every interval: (n_samples - 1, PARTS, n_ū) at the two
    ends, and (n_samples - 1, PARTS, 2, n_ū)."""
    u0, u1, bent = inputs
    r = np.arange(PARTS + 1)[None, :, None] / PARTS
    edges = u0[:, None] + r * (u1 - u0)[:, None]
    if bent is None:
        return edges[:, :-1], edges[:, 1:], None
    a, b = bent[:, None, 0], bent[:, None, 1]
    edges = edges + r * (1.0 - r) * (a + b * r)
    cubic = b / PARTS**3 + 0.0 * r[:, :-1]
    square = (b - a - 3.0 * b * r[:, :-1]) / PARTS**2
    return edges[:, :-1], edges[:, 1:], np.stack([cubic - square, cubic], axis=2)
