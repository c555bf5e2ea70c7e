"""The loops of `numerics/local_linear.c` in NumPy, for machines without a C compiler: the same results,
slowly.

Values and their derivatives travel together as jets: an array (1 + d, ...) whose first entry is the value and
whose others are derivatives along d directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.estimation.filter_engines.filter_task import (
    NOT_FINITE,
    SINGULAR_INNOVATION,
    Directions,
    Task,
    raise_failure,
)
from daest.estimation.gates import FIT
from daest.numerics.projection import MOST_STEPS, pull
from daest.systems.events.integration import IntegrationError
from daest.systems.simulation.local_linear import LocalModel
from daest.systems.tolerances import SOLVER

ORDER, RADIUS, MOST_DOUBLINGS = 12, 0.25, 60  # of the Taylor series, as in substep.c


def ekf(
    task: Task,
    white: np.ndarray,
    log_variance: np.ndarray,
    directions: Directions | None,
    dwhite: np.ndarray,
    dlog: np.ndarray,
    details: list[np.ndarray] | None,
) -> None:
    """The extended Kalman filter; fills the arrays as `daest_ekf` does. Shapes: white and log_variance
    (n_samples, n_y), dwhite and dlog (n_samples, d, n_y)."""
    data, model = task.data, task.model
    along = _Along.of(task, directions)
    x, P = along.mean(task.start.mean), along.constant(task.start.cov)
    x, P, _ = _projected(task, along, x, P, data.u0[0], float(data.time[0]))
    for i, time in enumerate(data.time):
        predicted = (x[0].copy(), P[0].copy())
        seen = _see(model, x, data.u0[i], task.theta, time, along)
        x, P, e, s = _update(x, P, seen, data.outputs[i], along.variance)
        for j in range(e.shape[1]):
            if np.isfinite(data.outputs[i, j]):
                _check(e[0, j], s[0, j], task, i)
                white[i, j], log_variance[i, j] = e[0, j] / np.sqrt(s[0, j]), np.log(s[0, j])
                dwhite[i, :, j] = (e[1:, j] - 0.5 * e[0, j] * s[1:, j] / s[0, j]) / np.sqrt(s[0, j])
                dlog[i, :, j] = s[1:, j] / s[0, j]
            else:
                white[i, j] = log_variance[i, j] = 0.0
                dwhite[i, :, j] = dlog[i, :, j] = 0.0
        x, P, turn = _projected(task, along, x, P, data.u0[i], time)
        flow = Flow(task, along, transition=np.eye(model.n_states))
        filtered = (x[0].copy(), P[0].copy())
        if i + 1 < data.time.size:
            x, P = flow.over(i, x, P)
        if details is not None:
            sight = seen[1][0]
            rows = (*predicted, *filtered, e[0], s[0], sight, flow.transition, flow.noise, turn)
            for table, row in zip(details, rows, strict=True):
                table[i] = row


def _check(innovation: float, variance: float, task: Task, sample: int) -> None:
    if not (np.isfinite(innovation) and np.isfinite(variance)):
        raise_failure(NOT_FINITE, task.model, task.data, sample)
    if not variance > 0.0:
        raise_failure(SINGULAR_INNOVATION, task.model, task.data, sample)


@dataclass(frozen=True)
class _Along:
    """Jets of everything constant: parameters (d, n_p), intensities (1+d, n_w), variances (1+d, n_y)."""

    directions: Directions | None
    intensity: np.ndarray
    variance: np.ndarray

    @classmethod
    def of(cls, task: Task, directions: Directions | None = None) -> _Along:
        if directions is None:
            return cls(None, task.noise.intensity[None], task.noise.variance[None])
        return cls(
            directions,
            np.vstack([task.noise.intensity, directions.intensity]),
            np.vstack([task.noise.variance, directions.variance]),
        )

    @property
    def n(self) -> int:
        return 0 if self.directions is None else self.directions.n

    def mean(self, value: np.ndarray) -> np.ndarray:
        return value[None].copy() if self.directions is None else np.vstack([value, self.directions.mean])

    def constant(self, value: np.ndarray) -> np.ndarray:
        return np.concatenate([value[None], np.zeros((self.n, *value.shape))])

    def jets(
        self,
        function: ca.Function,
        differential: ca.Function | None,
        x: np.ndarray,
        arguments: tuple,
        shapes: list[tuple[int, ...]],
        *more: np.ndarray,
    ) -> list[np.ndarray]:
        """Results of a function of (x, *arguments, *more) as jets of the given shapes; `more` are jets."""
        given = [*arguments, *(part[0] for part in more)]
        try:
            values = [function.call([x[0], *given])]
            for d in range(self.n):
                assert differential is not None and self.directions is not None
                moved = [x[1 + d], self.directions.parameters[d], *(part[1 + d] for part in more)]
                values.append(differential.call([x[0], *given, *moved]))
        except RuntimeError:  # a nonlinear equation inside the model has no solution
            return [np.full((1 + self.n, *shape), np.nan) for shape in shapes]
        return [
            np.array([np.array(result).ravel() for result in column]).reshape(1 + self.n, *shape)
            for column, shape in zip(zip(*values, strict=True), shapes, strict=True)
        ]


def _see(
    model: LocalModel, x: np.ndarray, u: np.ndarray, theta: np.ndarray, time: float, along: _Along
) -> list[np.ndarray]:
    n, n_y = model.n_states, model.n_outputs
    return along.jets(model.see, model.dsee, x, (u, theta, time), [(n_y,), (n_y, n)])


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Jet of a matrix product."""
    result = a @ b[0]
    result[1:] += a[0] @ b[1:]
    return result


def _inverse(a: np.ndarray) -> np.ndarray:
    result = np.empty_like(a)
    result[0] = np.linalg.inv(a[0])
    result[1:] = -result[0] @ a[1:] @ result[0]
    return result


def _applied(a: np.ndarray, v: np.ndarray) -> np.ndarray:
    return _product(a, v[..., None])[..., 0]


def _transposed(a: np.ndarray) -> np.ndarray:
    return np.swapaxes(a, 1, 2)


def _symmetric(a: np.ndarray) -> np.ndarray:
    return (a + _transposed(a)) / 2


def _update(
    x: np.ndarray, P: np.ndarray, seen: list[np.ndarray], y: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Output by output; also the innovations and their variances, jets (1 + d, n_y)."""
    h, C = seen
    start = x.copy()
    innovations, variances = np.empty_like(h), np.empty_like(h)
    for j in range(y.size):
        c = C[:, j]
        Pc = _applied(P, c)
        s = variance[:, j] + _inner(c, Pc)
        e = -h[:, j] - _inner(c, x - start)
        e[0] += y[j]
        innovations[:, j], variances[:, j] = e, s
        if np.isfinite(y[j]):
            gain = _scaled(Pc, 1.0 / s[0], -s[1:] / s[0] ** 2)
            x = x + _scaled(gain, e[0], e[1:])
            P = P - _product(gain[..., None], Pc[:, None, :])
    return x, _symmetric(P), innovations, variances


def _inner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return _product(a[:, None, :], b[..., None])[:, 0, 0]


def _scaled(a: np.ndarray, factor: float, slopes: np.ndarray) -> np.ndarray:
    result = a * factor
    result[1:] += a[0] * slopes[:, None]
    return result


class Flow:
    """Mean and covariance over sample intervals; `transition` and `noise` as in `ekf.EkfRun`. Sharp steps are
    averaged over the covariance if `is_averaged`."""

    def __init__(
        self,
        task: Task,
        along: _Along | None = None,
        transition: np.ndarray | None = None,
        is_averaged: bool = True,
    ) -> None:
        self.task, self.is_averaged = task, is_averaged
        self.along = _Along.of(task) if along is None else along
        n = task.model.n_states
        self.transition = np.eye(n) if transition is None else transition
        self.noise = np.zeros((n, task.model.n_noises))

    def over(self, i: int, x: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Jets of x and P at sample i + 1 from those at sample i."""
        data = self.task.data
        dt = float(data.time[i + 1] - data.time[i])
        n = max(1, int(np.ceil(dt / self.task.longest * (1.0 - 1e-9))))
        rise = data.u1[i] - data.u0[i]
        for k in range(n):
            u = data.u0[i] + rise * k / n
            x, P = self._substep(i, x, P, u, rise / dt, float(data.time[i]) + k * dt / n, dt / n, dt)
        x, P, turn = _projected(self.task, self.along, x, P, data.u1[i], float(data.time[i + 1]))
        self.transition = turn @ self.transition
        if not np.all(np.isfinite(x)):
            raise_failure(NOT_FINITE, self.task.model, data, i)
        return x, P

    def _substep(
        self,
        i: int,
        x: np.ndarray,
        P: np.ndarray,
        u: np.ndarray,
        slope: np.ndarray,
        t: float,
        h: float,
        dt: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        model, n, n_w = self.task.model, self.task.model.n_states, self.task.model.n_noises
        shapes = [(n,), (n, n), (n,), (n, n_w)]
        theta = self.task.theta
        over = P if self.is_averaged else np.zeros_like(P)
        f, A, ramp, G = self.along.jets(model.flow, model.dflow, x, (u, slope, theta, t), shapes, over)
        self._check(A, f, i)
        increment = solved(f, A, ramp, np.zeros_like(A), h)[1]
        end = x + increment
        ahead = (u + slope * h, slope, theta, t + h)
        _, A_end, _, G_end = self.along.jets(model.flow, model.dflow, end, ahead, shapes, over)
        A, G = (A + A_end) / 2, (G + G_end) / 2
        self._check(A, f, i)
        weighted = G * self.along.intensity[0]
        weighted[1:] += G[0] * self.along.intensity[1:, None, :]
        phi, _, Q, psi = solved(f, A, ramp, _product(weighted, _transposed(G)), h)
        self.transition = phi[0] @ self.transition
        self.noise = phi[0] @ self.noise + psi[0] @ G[0] * self.task.noise.intensity / dt
        return end, _symmetric(_product(_product(phi, P), _transposed(phi)) + Q)

    def _check(self, A: np.ndarray, f: np.ndarray, i: int) -> None:
        if not (np.all(np.isfinite(A[0])) and np.all(np.isfinite(f[0]))):
            raise_failure(NOT_FINITE, self.task.model, self.task.data, i)


def solved(
    f: np.ndarray, A: np.ndarray, ramp: np.ndarray, D: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """exp(A h), the increment of the mean, ∫ exp(Aτ) D exp(Aτ)ᵀ dτ and ∫ exp(Aτ) dτ over h, all as jets.
    Shapes of jets with d directions: f and ramp (1 + d, n), A and D (1 + d, n, n); h [s]."""
    size = min(np.abs(A[0]).sum(axis=0).max(), np.abs(A[0]).sum(axis=1).max()) * h
    doublings = min(max(0, int(np.ceil(np.log2(max(size, RADIUS) / RADIUS)))), MOST_DOUBLINGS)
    s = h / 2**doublings
    eye = np.zeros_like(A)
    eye[0] = np.eye(A.shape[1])
    Q = term = D * s
    second = _tail(A, s, 2)
    psi = eye + _product(A, second) * s
    phi = eye + _product(A, psi) * s
    psi, second = psi * s, second * s**2
    for k in range(2, ORDER + 1):
        product = _product(A, term)
        term = (product + _transposed(product)) * (s / k)
        Q = Q + term
    for _ in range(doublings):
        second = second + _product(phi, second) + s * psi
        psi = psi + _product(phi, psi)
        Q = _symmetric(Q + _product(_product(phi, Q), _transposed(phi)))
        phi = _product(phi, phi)
        s *= 2.0
    return phi, _applied(psi, f) + _applied(second, ramp), Q, psi


def _tail(A: np.ndarray, s: float, order: int) -> np.ndarray:
    """Σ_k (A s)^k / (k + order)!, by Horner's rule."""
    eye = np.zeros_like(A)
    eye[0] = np.eye(A.shape[1])
    result = eye.copy()
    for k in range(ORDER, 0, -1):
        result = eye + _product(A, result) * (s / (k + order))
    return result / float(np.prod(np.arange(1, order + 1)))


def _projected(
    task: Task, along: _Along, x: np.ndarray, P: np.ndarray, u: np.ndarray, time: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`project` for jets, each step differentiated."""
    model = task.model
    if model.hold is None or not along.n:
        x[0], P[0], turn = project(task, x[0], P[0], u, time)
        return x, P, turn
    m, n = model.hold.numel_out(0), model.n_states
    for _ in range(MOST_STEPS):
        g, R = along.jets(model.hold, model.dhold, x, (u, task.theta, time), [(m,), (m, n)])
        weighted = _transposed(R) * task.scale[:, None] ** 2
        gain = _product(weighted, _inverse(_product(R, weighted)))
        step = _applied(gain, g)
        x = x - step
        if np.max(np.abs(step[0]) / task.scale) < SOLVER.projected_to_rounding:
            break
    turn = -_product(gain, R)
    turn[0] += np.eye(n)
    return x, _symmetric(_product(_product(turn, P), _transposed(turn))), turn[0]


def project(
    task: Task, x: np.ndarray, P: np.ndarray, u: np.ndarray, time: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x on the invariants of the model, smallest step in the sizes of the states; P along with it; and the
    projection T of small changes (the identity where there are no invariants). Shapes: x (n,), P and T (n,
    n), u (n_ū,); time [s]."""
    if task.model.hold is None:
        return x, P, np.eye(x.size)
    hold = task.model.hold

    def invariants(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        g, R = (np.array(part) for part in hold(at, u, task.theta, time))
        return g.ravel(), R.reshape(g.size, at.size)

    pulled = pull(invariants, x, task.scale, SOLVER.projected_to_rounding)
    along = pulled.along
    P = along @ P @ along.T
    return pulled.x, (P + P.T) / 2, along


def points_hold(task: Task, i: int, points: np.ndarray) -> np.ndarray:
    """Points (m, n) at sample i on the invariants of the model."""
    n = points.shape[1]
    return np.array(
        [project(task, x, np.zeros((n, n)), task.data.u0[i], float(task.data.time[i]))[0] for x in points]
    )


def ukf(task: Task, weights: np.ndarray, tables: list[np.ndarray]) -> None:
    """The unscented Kalman filter; fills the tables of `ukf.UkfRun` as `daest_ukf` does. Shapes: weights
    (4,)."""
    data, model = task.data, task.model
    n, n_y = model.n_states, model.n_outputs
    spread, mean0, cov0, each = weights
    mean_weight, cov_weight = (np.concatenate([[w], np.full(2 * n, each)]) for w in (mean0, cov0))
    x, P, _ = project(task, task.start.mean, task.start.cov, data.u0[0], float(data.time[0]))
    for i, time in enumerate(data.time):
        predicted = (x, P)
        points = points_hold(task, i, sigma_points(x, P, spread))
        seen, _ = evaluate(model.see, points, (data.u0[i], task.theta, time), [(n_y,), (n_y, n)])
        mean = mean_weight @ seen
        S = (seen - mean).T * cov_weight @ (seen - mean) + np.diag(task.noise.variance)
        x, P, log_density, nis = gaussian_update(
            task, i, x, P, (points - x).T * cov_weight @ (seen - mean), data.outputs[i] - mean, S
        )
        x, P, _ = project(task, x, P, data.u0[i], time)
        row = [*predicted, x, P, data.outputs[i] - mean, S, log_density, nis]
        row += [np.zeros((n, n)), np.zeros((n, model.n_noises))]
        if i + 1 < data.time.size:
            x, P, row[3], row[8], row[9] = _unscented_flow(task, i, x, P, spread, mean_weight, cov_weight)
        for table, value in zip(tables, row, strict=True):
            table[i] = value


def sigma_points(x: np.ndarray, P: np.ndarray, spread: float) -> np.ndarray:
    """The mean x (n,), then x plus and minus `spread` times each column of a root of P (n, n): (2 n + 1,
    n)."""
    steps = spread * square_root(P).T
    return np.vstack([x, x + steps, x - steps])


def square_root(P: np.ndarray) -> np.ndarray:
    """Lower triangular L with L Lᵀ = P for covariances (..., n, n) that may be singular: a pivot below the
    rounding of its diagonal gives a column of zeros."""
    L = np.zeros_like(P)
    for j in range(P.shape[-1]):
        pivot = P[..., j, j] - np.sum(L[..., j, :j] ** 2, axis=-1)
        open_ = pivot > FIT.singular_pivot * P[..., j, j]
        diagonal = np.sqrt(np.where(open_, pivot, 1.0))
        rest = P[..., j:, j] - np.einsum("...ik,...k->...i", L[..., j:, :j], L[..., j, :j])
        L[..., j:, j] = np.where(open_[..., None], rest / diagonal[..., None], 0.0)
    return L


def gaussian_update(
    task: Task, i: int, x: np.ndarray, P: np.ndarray, cross: np.ndarray, innovation: np.ndarray, S: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Mean (n,), covariance (n, n), log-density and normalised innovation squared after sample i. Shapes:
    cross (n, n_y), innovation (n_y,), S (n_y, n_y). Raises EstimationError `filter-singular-innovation`,
    IntegrationError."""
    there = np.isfinite(task.data.outputs[i])
    if not np.all(np.isfinite(innovation[there])):
        raise_failure(NOT_FINITE, task.model, task.data, i)
    if not np.any(there):
        return x, P, 0.0, 0.0
    L = square_root(S[np.ix_(there, there)])
    if not np.all(np.diagonal(L) > 0.0):
        raise_failure(SINGULAR_INNOVATION, task.model, task.data, i)
    white = np.linalg.solve(L, innovation[there])
    gain = np.linalg.solve(L, cross[:, there].T).T
    nis = float(white @ white)
    log_density = -0.5 * (nis + white.size * np.log(2 * np.pi)) - float(np.sum(np.log(np.diagonal(L))))
    P = P - gain @ gain.T
    return x + gain @ white, (P + P.T) / 2, log_density, nis


def _unscented_flow(
    task: Task,
    i: int,
    x: np.ndarray,
    P: np.ndarray,
    spread: float,
    mean_weight: np.ndarray,
    cov_weight: np.ndarray,
) -> tuple[np.ndarray, ...]:
    n = x.size
    before = points_hold(task, i, sigma_points(x, P, spread))
    # Points that were moved onto invariants have another covariance, which is what a smoother must see.
    P = P if task.model.hold is None else (before - x).T * cov_weight @ (before - x)
    centre = Flow(task, is_averaged=False)  # the points carry the distribution
    ends = [centre.over(i, x[None].copy(), np.zeros((1, n, n)))]
    ends += [
        Flow(task, is_averaged=False).over(i, point[None].copy(), np.zeros((1, n, n))) for point in before[1:]
    ]
    after = np.array([mean[0] for mean, _ in ends])
    mean = mean_weight @ after
    P_next = (after - mean).T * cov_weight @ (after - mean) + ends[0][1][0]
    cross = (before - x).T * cov_weight @ (after - mean)
    data = task.data
    mean, P_next, along = project(task, mean, P_next, data.u1[i], float(data.time[i + 1]))
    return mean, P_next, P, cross @ along.T, centre.noise


def points_advance(task: Task, i: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means (m, n) and covariances (m, n, n) after interval i from m points; NaN where there is none."""
    m, n = points.shape
    means, covs = np.full((m, n), np.nan), np.zeros((m, n, n))
    for k, x in enumerate(points):
        try:
            mean, cov = Flow(task).over(i, x[None].copy(), np.zeros((1, n, n)))
        except IntegrationError:
            continue
        means[k], covs[k] = mean[0], cov[0]
    return means, covs


def evaluate(
    function: ca.Function, points: np.ndarray, arguments: tuple, shapes: list[tuple[int, ...]]
) -> list[np.ndarray]:
    """Results of a function of (x, *arguments) at m points, (m, *shape) each."""
    columns = function.map(points.shape[0])
    repeated = [ca.repmat(ca.DM(a), 1, points.shape[0]) for a in arguments]
    values = columns.call([ca.DM(points.T), *repeated])
    return [np.array(v).T.reshape(points.shape[0], *shape) for v, shape in zip(values, shapes, strict=True)]
