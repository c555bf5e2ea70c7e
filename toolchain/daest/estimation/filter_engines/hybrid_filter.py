"""Extended, unscented and particle filter of a model with events.

Between samples the state of the filter and its mode follow the model through its events: the mean by the
integrator of the simulation, the covariance by the transition of each smooth piece, the saltation matrix of
each event and the process noise of the pieces, whose linearisation is the average of those at both ends. A
controller that samples is part of the model: what it keeps between its ticks are states of the filter. After
a measurement the state is brought to the side of every switch that its mode has (`Passages.agreed`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines.filter_task import (
    NOT_FINITE,
    SINGULAR_INNOVATION,
    Start,
    Task,
    raise_failure,
)
from daest.estimation.filter_engines.interpreted import gaussian_update, sigma_points, solved, square_root
from daest.numerics.evaluator import Evaluator
from daest.systems.events.event_update import Mode
from daest.systems.events.hybrid import Inputs
from daest.systems.events.passages import Leg, Passages
from daest.systems.simulation.integrate import search_steps
from daest.systems.tolerances import SOLVER


@dataclass(frozen=True)
class Step:
    """From one sample to the next: x (n,), transition (n, n), covariance (n, n) of what the process noise
    adds, and its covariance (n, n_w) with the mean of the noise over the interval."""

    x: np.ndarray
    transition: np.ndarray
    cov: np.ndarray
    noise: np.ndarray


class Mover:
    """The model of a task under its inputs."""

    def __init__(self, task: Task) -> None:
        self.task, data = task, task.data
        assert task.model.engine is not None
        inputs = Inputs(data.time, data.u0[:-1], data.u1[:-1], data.u0[-1:])
        scale = np.maximum(np.abs(task.scale), 1e-30)
        atol = np.ascontiguousarray(SOLVER.search_rtol * SOLVER.atol_of_scale * scale)
        most = search_steps(data.time.size)
        self._see, self._flow = Evaluator(task.model.see), Evaluator(task.model.flow)
        self.passages = Passages(task.model.engine, inputs, SOLVER.search_rtol, atol, most)

    def start(self, mode: Mode | None = None) -> tuple[np.ndarray, np.ndarray, Mode]:
        """Mean, covariance and mode before the first measurement; with a `mode` the filter goes on. Shapes:
        mean (n,), covariance (n, n)."""
        task = self.task
        if mode is not None:
            return task.start.mean, task.start.cov, mode.copy()
        x, mode, legs = self.passages.start(task.theta, task.start.mean)
        P = task.start.cov
        for leg in legs:
            assert leg.jump is not None
            P = leg.jump @ P @ leg.jump.T
        return x, P, mode

    def over(self, k: int, x: np.ndarray, mode: Mode) -> Step:
        """Over the interval that follows sample k. Shapes: x (n,)."""
        x_next, legs = self.passages.over(k, x, mode)
        n, n_w = x.size, self.task.model.n_noises
        transition, Q, noise = np.eye(n), np.zeros((n, n)), np.zeros((n, n_w))
        for leg in legs:
            transition, noise, Q = (leg.transition @ part for part in (transition, noise, Q))
            Q = Q @ leg.transition.T
            if n_w and leg.end > leg.start:
                added, own = self._added(k, leg)
                Q, noise = Q + added, noise + own
            if leg.jump is not None:
                transition, noise, Q = (leg.jump @ part for part in (transition, noise, Q))
                Q = Q @ leg.jump.T
        if not np.all(np.isfinite(x_next)):
            raise_failure(NOT_FINITE, self.task.model, self.task.data, k)
        return Step(x_next, transition, (Q + Q.T) / 2, noise)

    def agreed(
        self, k: int, x: np.ndarray, P: np.ndarray, mode: Mode
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean and covariance that agree with the mode, and the slope of the change. Shapes: x (n,), P and
        slope (n, n)."""
        x, turn = self.passages.agreed(k, x, P, mode)
        P = turn @ P @ turn.T
        return x, (P + P.T) / 2, turn

    def see(self, k: int, x: np.ndarray, mode: Mode) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (n_y,) at sample k and their slopes (n_y, n)."""
        data = self.task.data
        h, C = self._see(x, data.u0[k], mode.theta, data.time[k])
        return h.ravel(), C.reshape(-1, x.size)

    def _added(self, k: int, leg: Leg) -> tuple[np.ndarray, np.ndarray]:
        """What white noise adds on a leg: covariance (n, n) at its end, and with the mean of the noise."""
        task, data = self.task, self.task.data
        dt = float(data.time[k + 1] - data.time[k])
        slope = (data.u1[k] - data.u0[k]) / dt
        n, n_w = task.model.n_states, task.model.n_noises
        A, G = np.zeros((n, n)), np.zeros((n, n_w))
        for t, x in zip((leg.start, leg.end), leg.states, strict=True):
            u = data.u0[k] + slope * (t - data.time[k])
            parts = self._flow(x, u, slope, leg.theta, t, np.zeros(n * n))
            A += parts[1].reshape(n, n) / 2
            G += parts[3].reshape(n, n_w) / 2
        nothing = np.zeros((1, n))
        weighted = (G * task.noise.intensity) @ G.T
        h = leg.end - leg.start
        _, _, Q, psi = solved(nothing, A[None], nothing, weighted[None], h)
        return Q[0], psi[0] @ G * task.noise.intensity / dt


def ekf(
    task: Task,
    white: np.ndarray,
    log_variance: np.ndarray,
    details: list[np.ndarray],
    mode: Mode | None = None,
) -> tuple[np.ndarray, Mode]:
    """The extended Kalman filter; fills the tables of `ekf.EkfRun` as `interpreted.ekf` does, and returns the
    parameters with the mode at each sample (n_samples, n_theta), and the mode of the last one. `mode`: that
    of the first sample, where the filter goes on."""
    data, mover = task.data, Mover(task)
    modes = np.empty((data.time.size, task.theta.size))
    x, P, mode = mover.start(mode)
    for k in range(data.time.size):
        predicted = (x, P)
        h, C = mover.see(k, x, mode)
        x, P, e, s = _update(task, k, x, P, h, C)
        there = np.isfinite(data.outputs[k])
        white[k] = np.where(there, e / np.sqrt(s), 0.0)
        log_variance[k] = np.where(there, np.log(s), 0.0)
        x, P, turn = mover.agreed(k, x, P, mode)
        modes[k] = mode.theta
        filtered = (x, P)
        step = _standing(task)
        if k + 1 < data.time.size:
            step = mover.over(k, x, mode)
            x, P = step.x, step.transition @ P @ step.transition.T + step.cov
        rows = (*predicted, *filtered, e, s, C, step.transition, step.noise, turn)
        for table, row in zip(details, rows, strict=True):
            table[k] = row
    return modes, mode


def _standing(task: Task) -> Step:
    n = task.model.n_states
    return Step(task.start.mean, np.eye(n), np.zeros((n, n)), np.zeros((n, task.model.n_noises)))


def _update(
    task: Task, k: int, x: np.ndarray, P: np.ndarray, h: np.ndarray, C: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Output by output; also the innovations and their variances (n_y,)."""
    y, start = task.data.outputs[k], x
    e, s = np.full(y.size, np.nan), np.ones(y.size)
    for j in range(y.size):
        Pc = P @ C[j]
        s[j] = task.noise.variance[j] + C[j] @ Pc
        if not np.isfinite(y[j]):
            continue
        e[j] = y[j] - h[j] - C[j] @ (x - start)
        if not (np.isfinite(e[j]) and np.isfinite(s[j])):
            raise_failure(NOT_FINITE, task.model, task.data, k)
        if not s[j] > 0.0:
            raise_failure(SINGULAR_INNOVATION, task.model, task.data, k)
        gain = Pc / s[j]
        x, P = x + gain * e[j], P - np.outer(gain, Pc)
    return x, (P + P.T) / 2, e, s


def ukf(
    task: Task, weights: np.ndarray, tables: list[np.ndarray], mode: Mode | None = None
) -> tuple[np.ndarray, Mode]:
    """The unscented Kalman filter, each point with a mode of its own from sample to sample; fills the tables
    as `interpreted.ukf` does and returns the parameters with the mode of the centre (n_samples, n_theta), and
    the last mode. `mode` as in `ekf`."""
    data, mover = task.data, Mover(task)
    n, n_w = task.model.n_states, task.model.n_noises
    spread, mean0, cov0, each = weights
    mean_weight, cov_weight = (np.concatenate([[w], np.full(2 * n, each)]) for w in (mean0, cov0))
    modes = np.empty((data.time.size, task.theta.size))
    x, P, mode = mover.start(mode)
    for k in range(data.time.size):
        predicted = (x, P)
        points, own = _points(mover, k, x, P, mode, spread)
        seen = np.array([mover.see(k, p, m)[0] for p, m in zip(points, own, strict=True)])
        mean = mean_weight @ seen
        S = (seen - mean).T * cov_weight @ (seen - mean) + np.diag(task.noise.variance)
        cross = (points - x).T * cov_weight @ (seen - mean)
        innovation = data.outputs[k] - mean
        x, P, log_density, nis = gaussian_update(task, k, x, P, cross, innovation, S)
        x, P, _ = mover.agreed(k, x, P, mode)
        modes[k] = mode.theta
        row = [*predicted, x, P, innovation, S, log_density, nis, np.zeros((n, n)), np.zeros((n, n_w))]
        if k + 1 < data.time.size:
            before, own = _points(mover, k, x, P, mode, spread)
            steps = [mover.over(k, p, m) for p, m in zip(before, own, strict=True)]
            after = np.array([step.x for step in steps])
            mode, x_next = own[0], mean_weight @ after
            row[8] = (before - x).T * cov_weight @ (after - x_next)
            row[9] = steps[0].noise
            P = (after - x_next).T * cov_weight @ (after - x_next) + steps[0].cov
            x = x_next
        for table, value in zip(tables, row, strict=True):
            table[k] = value
    return modes, mode


def _points(
    mover: Mover, k: int, x: np.ndarray, P: np.ndarray, mode: Mode, spread: float
) -> tuple[np.ndarray, list[Mode]]:
    """Sigma points, each on the side of every switch that its mode has; the centre keeps the mode."""
    points = sigma_points(x, P, spread)
    own = [mode.copy() for _ in points]
    for i in range(1, len(points)):
        points[i], _ = mover.passages.agreed(k, points[i], P, own[i])
    return points, own


class HybridPoints:
    """Particles of a model with events, as a `particle.PointModel`: each with a mode of its own. The process
    noise of an interval is that of the mean of all particles in the same mode."""

    has_memory = True

    def __init__(self, task: Task) -> None:
        self.task, self.mover = task, Mover(task)
        flat = task.model.explicit.flat
        assert flat.events is not None
        self.memory = np.flatnonzero([p.is_memory for p in flat.parameters])
        self._discrete = [one.slot for one in flat.events.assignments if one.slot >= 0]
        self._switches = [one.slot for one in flat.events.relations]
        self._switches += [one.slot for one in flat.events.whole_parts] + self._discrete
        self.modes: list[Mode] = []
        self.kept: list[np.ndarray] = []  # of every sample: what particles keep between events (m, n_memory)

    @property
    def start(self) -> Start:
        """After the events at the first sample."""
        x, P, self._mode = self.mover.start()
        return Start(x, P)

    def advance(self, k: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means (m, n) at sample k + 1 and roots (m, n, n) of the covariance of the noise."""
        roots = self._roots(k, points)
        means = np.full_like(points, np.nan)
        for i, x in enumerate(points):
            if np.all(np.isfinite(x)):
                try:
                    means[i], _ = self.mover.passages.over(k, x, self.modes[i])
                except EstimationError:
                    continue
        return means, roots

    def hold(self, k: int, points: np.ndarray) -> np.ndarray:
        """Particles on the side of every switch that their mode has. Shapes: points (m, n)."""
        held = points.copy()
        cov = np.diag(np.maximum(np.var(points, axis=0), np.finfo(float).tiny))
        for i, x in enumerate(points):
            if np.all(np.isfinite(x)):
                held[i], _ = self.mover.passages.agreed(k, x, cov, self.modes[i])
        self.kept.append(np.array([mode.theta[self.memory] for mode in self.modes]))
        return held

    def see(self, k: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (m, n_y) at sample k and their slopes (m, n_y, n)."""
        if not self.modes:
            self.modes = [self._mode.copy() for _ in points]
        n_y, n = self.task.model.n_outputs, points.shape[1]
        h, C = self._each(self.task.model.see, k, points, [(n_y,), (n_y, n)])
        return h, C

    def select(self, rows: np.ndarray) -> None:
        """The particles `rows`, each as often as it stands there. Shapes: rows (m,)."""
        self.modes = [self.modes[i].copy() for i in rows]

    def inside(
        self, k: int, points: np.ndarray, weights: np.ndarray, rows: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (n_v,) at sample k of the internal variables, then of the Boolean and
        Integer ones that events assign, of which the mean of a Boolean is the probability of true; `rows` of
        the particles of that sample."""
        assert self.task.model.inside is not None
        kept = self.kept[k] if rows is None else self.kept[k][rows]
        (values,) = self._with_memory(self.task.model.inside, k, points, kept, [(self.task.model.n_inside,)])
        values = np.hstack([values, kept[:, np.searchsorted(self.memory, self._discrete)]])
        mean = weights @ values
        return mean, np.sqrt(np.maximum(weights @ (values - mean) ** 2, 0.0))

    def _each(
        self, function: Callable, k: int, points: np.ndarray, shapes: list[tuple[int, ...]]
    ) -> list[np.ndarray]:
        kept = np.array([mode.theta[self.memory] for mode in self.modes])
        return self._with_memory(function, k, points, kept, shapes)

    def _with_memory(
        self,
        function: Callable,
        k: int,
        points: np.ndarray,
        kept: np.ndarray,
        shapes: list[tuple[int, ...]],
    ) -> list[np.ndarray]:
        theta = np.repeat(self.task.theta[:, None], len(points), axis=1)
        theta[self.memory] = kept.T
        data = self.task.data
        columns = function.map(len(points)).call(  # type: ignore[attr-defined]
            [points.T, np.repeat(data.u0[k][:, None], len(points), axis=1), theta,
             np.full((1, len(points)), data.time[k])]
        )  # fmt: skip
        return [np.array(v).T.reshape(len(points), *shape) for v, shape in zip(columns, shapes, strict=True)]

    def _roots(self, k: int, points: np.ndarray) -> np.ndarray:
        task, n = self.task, points.shape[1]
        roots = np.zeros((len(points), n, n))
        if not task.model.n_noises:
            return roots
        told = np.array([mode.theta[self._switches] for mode in self.modes])
        _, group = np.unique(told, axis=0, return_inverse=True)
        group = group.ravel()
        for number in np.unique(group):
            rows = np.flatnonzero((group == number) & np.all(np.isfinite(points), axis=1))
            if not rows.size:
                continue
            mode = self.modes[rows[0]].copy()
            middle, _ = self.mover.passages.agreed(k, points[rows].mean(axis=0), np.eye(n), mode)
            roots[group == number] = square_root(self.mover.over(k, middle, mode).cov)
        return roots
