"""Particle filter and smoother for models whose transition over a sample is Gaussian given the state.

Bootstrap filter (Gordon, Salmond & Smith 1993), or with the proposal of a local extended filter for each
particle (Doucet, Godsill & Andrieu 2000); systematic resampling when the effective sample size falls. The
smoother simulates backwards (Godsill, Doucet & West 2004). All random numbers come from one seeded generator
before the work is divided among threads: results do not depend on the number of threads.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines import interpreted
from daest.estimation.filter_engines.filter_task import Noise, Start, Task, raise_failure
from daest.estimation.filter_engines.interpreted import square_root
from daest.estimation.filter_engines.particle_loop import ParticleLoop
from daest.estimation.gates import FIT
from daest.numerics.compiler import pointer
from daest.systems.simulation.lanes import lane_library

Proposal = Literal["bootstrap", "ekf"]

MOST_TRAJECTORIES = 200  # of the backward simulation
SMALLEST_CHUNK = 1000  # particles per thread: waking one takes as long as hundreds of them


class PointModel(Protocol):
    """A discrete-time model x[k+1] = mean(x[k]) + root z, y = h(x) + e with z, e independent and Gaussian.

    `has_memory`: particles keep more than their state, so that their future does not follow from it alone.
    """

    has_memory: bool

    def advance(self, k: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means (m, n) and roots (m, n, n) of the covariances of the states at sample k + 1; NaN means where
        the model has no value."""
        ...

    def hold(self, k: int, points: np.ndarray) -> np.ndarray:
        """The points on the constraints that the states of sample k obey; the points themselves where there
        are none. Shapes: points (m, n)."""
        ...

    def see(self, k: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (m, n_y) at sample k, and their slopes ∂h/∂x (m, n_y, n)."""
        ...

    def select(self, rows: np.ndarray) -> None:
        """Particles were drawn again: each is now what that of its row was. Shapes: rows (m,)."""
        ...


@dataclass(frozen=True)
class ParticleRun:
    """Weighted particles at every sample, after its measurement.

    points (n_samples, m, n), weights (n_samples, m) normalised, ancestors (n_samples, m): which particle of
    the sample before each one comes from; effective (n_samples,): effective sample sizes before resampling;
    innovations (n_samples, n_y) with their covariance and normalised squares as in `ukf.UkfRun`;
    log_likelihood is the estimate of log p(y).
    """

    points: np.ndarray
    weights: np.ndarray
    ancestors: np.ndarray
    effective: np.ndarray
    innovations: np.ndarray
    innovation_cov: np.ndarray
    nis: np.ndarray
    log_likelihood: float

    @property
    def mean(self) -> np.ndarray:
        """(n_samples, n)."""
        return np.einsum("km,kmi->ki", self.weights, self.points)

    @property
    def cov(self) -> np.ndarray:
        """(n_samples, n, n)."""
        centred = self.points - self.mean[:, None, :]
        return np.einsum("km,kmi,kmj->kij", self.weights, centred, centred, optimize=True)

    @property
    def collapsed(self) -> np.ndarray:
        """Samples at which hardly any particle explains the measurement."""
        return np.flatnonzero(self.effective < FIT.collapsed_below)


@dataclass
class _Cloud:
    """Particles under way: candidates' means and roots become points with log weights."""

    points: np.ndarray
    log_weights: np.ndarray
    ancestors: np.ndarray
    log_likelihood: float = 0.0
    effective: list[float] = field(default_factory=list)


def run_particles(
    model: PointModel,
    outputs: np.ndarray,
    variance: np.ndarray,
    start: Start,
    n_particles: int,
    seed: int | None = None,
    proposal: Proposal = "ekf",
    time: np.ndarray | None = None,
) -> ParticleRun:
    """Filter outputs (n_samples, n_y), NaN where missing, with measurement variances (n_y,).

    `time` (n_samples,) is only named in errors. Raises EstimationError `particle-collapse` when no particle
    explains a measurement at all.
    """
    rng = np.random.default_rng(seed)
    if isinstance(model, ContinuousPoints):
        loop = model.loop(outputs, variance, start, n_particles, proposal)
        if loop is not None:
            return _run_compiled(loop, rng, time)
    n_samples, n_y = outputs.shape
    n = start.mean.size
    tables = _Tables(n_samples, n_particles, n, n_y)
    means = np.tile(start.mean, (n_particles, 1))
    roots = np.tile(square_root(start.cov), (n_particles, 1, 1))
    cloud = _Cloud(means, np.full(n_particles, -np.log(n_particles)), np.arange(n_particles))
    for k in range(n_samples):
        if k:
            means, roots = model.advance(k - 1, cloud.points)
        there = np.isfinite(outputs[k])
        _predict_output(model, k, means, roots, cloud, outputs[k], variance, tables)
        z, log_ratio = _draw(model, k, means, roots, outputs[k], variance, there, rng, proposal)
        cloud.points = model.hold(k, means + np.einsum("mij,mj->mi", roots, z))
        log_weights = (
            cloud.log_weights + log_ratio + _log_density(model, k, cloud.points, outputs[k], variance, there)
        )
        _weigh(cloud, log_weights, k if time is None else float(time[k]))
        tables.store(k, cloud)
        if cloud.effective[-1] < FIT.resampled_below * n_particles:
            _resample(cloud, rng)
            model.select(cloud.ancestors)
        else:
            cloud.ancestors = np.arange(n_particles)
    return tables.run(cloud)


def _run_compiled(loop: ParticleLoop, rng: np.random.Generator, time: np.ndarray | None) -> ParticleRun:
    """As the loop of `run_particles`, with the same random numbers."""
    n_samples, m, n = loop.points.shape
    alike, z = True, np.empty((m, n))
    for k in range(n_samples):
        if not loop.weigh(k, rng.standard_normal(out=z), alike):
            raise _collapse(k if time is None else float(time[k]))
        alike = bool(loop.effective[k] < FIT.resampled_below * m)
        loop.follow(k, rng.uniform() if alike else None)
    return ParticleRun(
        loop.points, loop.weights, loop.ancestors, loop.effective,
        loop.innovations, loop.covariances, _squares(loop), loop.log_likelihood,
    )  # fmt: skip


def _squares(loop: ParticleLoop) -> np.ndarray:
    """Normalised squares (n_samples,) of the innovations that are there."""
    there = np.isfinite(loop.innovations)
    both = there[:, :, None] & there[:, None, :]
    S = np.where(both, loop.covariances, np.eye(there.shape[1]))
    v = np.where(there, loop.innovations, 0.0)
    return np.einsum("ki,ki->k", v, np.linalg.solve(S, v[..., None])[..., 0])


class _Tables:
    def __init__(self, n_samples: int, m: int, n: int, n_y: int) -> None:
        self.points = np.empty((n_samples, m, n))
        self.weights = np.empty((n_samples, m))
        self.ancestors = np.empty((n_samples, m), dtype=np.int32)
        self.innovations = np.full((n_samples, n_y), np.nan)
        self.innovation_cov = np.zeros((n_samples, n_y, n_y))
        self.nis = np.zeros(n_samples)

    def store(self, k: int, cloud: _Cloud) -> None:
        self.points[k], self.weights[k] = cloud.points, np.exp(cloud.log_weights)
        self.ancestors[k] = cloud.ancestors

    def run(self, cloud: _Cloud) -> ParticleRun:
        return ParticleRun(
            self.points, self.weights, self.ancestors, np.array(cloud.effective),
            self.innovations, self.innovation_cov, self.nis, cloud.log_likelihood,
        )  # fmt: skip


def _predict_output(
    model: PointModel,
    k: int,
    means: np.ndarray,
    roots: np.ndarray,
    cloud: _Cloud,
    y: np.ndarray,
    variance: np.ndarray,
    tables: _Tables,
) -> None:
    """Innovation, its covariance and normalised square, linearised around every particle's mean."""
    h, C = model.see(k, means)
    use = np.all(np.isfinite(h), axis=1)
    weights = np.where(use, np.exp(cloud.log_weights), 0.0)
    if not weights.sum() > 0.0:
        return
    weights = weights / weights.sum()
    h, H = np.where(use[:, None], h, 0.0), np.where(use[:, None, None], C @ roots, 0.0)
    mean = weights @ h
    spread = (np.sqrt(weights)[:, None, None] * H).transpose(1, 0, 2).reshape(h.shape[1], -1)
    S = (h - mean).T * weights @ (h - mean) + spread @ spread.T + np.diag(variance)
    tables.innovations[k], tables.innovation_cov[k] = y - mean, S
    there = np.isfinite(y)
    v = (y - mean)[there]
    tables.nis[k] = v @ np.linalg.solve(S[np.ix_(there, there)], v) if v.size else 0.0


def _draw(
    model: PointModel,
    k: int,
    means: np.ndarray,
    roots: np.ndarray,
    y: np.ndarray,
    variance: np.ndarray,
    there: np.ndarray,
    rng: np.random.Generator,
    proposal: Proposal,
) -> tuple[np.ndarray, np.ndarray]:
    """Standardised process noise z (m, n) of every particle, and log p(z) - log q(z).

    The proposal conditions z, not x, on the measurement: h(mean + root z) ≈ h(mean) + C root z. Transitions
    of any rank are then alike.
    """
    z = rng.standard_normal(means.shape)
    if proposal == "bootstrap" or not np.any(there):
        return z, np.zeros(means.shape[0])
    h, C = model.see(k, means)
    bad = ~np.all(np.isfinite(h), axis=1)
    H = np.where(bad[:, None, None], 0.0, (C @ roots)[:, there])
    weighted = np.swapaxes(H, 1, 2) / variance[there]
    precision = np.eye(means.shape[1]) + weighted @ H
    L = np.linalg.cholesky(precision)
    error = np.where(bad[:, None], 0.0, (y - h)[:, there])
    centre = np.linalg.solve(precision, (weighted @ error[..., None]))[..., 0]
    moved = centre + np.linalg.solve(np.swapaxes(L, 1, 2), z[..., None])[..., 0]
    log_q = -0.5 * np.sum(z**2, axis=1) + np.sum(np.log(np.diagonal(L, axis1=1, axis2=2)), axis=1)
    return moved, -0.5 * np.sum(moved**2, axis=1) - log_q


def _log_density(
    model: PointModel, k: int, points: np.ndarray, y: np.ndarray, variance: np.ndarray, there: np.ndarray
) -> np.ndarray:
    """log p(y | x) of every particle, -inf where the model has no value."""
    if not np.any(there):
        return np.where(np.all(np.isfinite(points), axis=1), 0.0, -np.inf)
    h, _ = model.see(k, points)
    v = variance[there]
    value = -0.5 * np.sum((y - h)[:, there] ** 2 / v + np.log(2 * np.pi * v), axis=1)
    return np.where(np.isfinite(value), value, -np.inf)


def _weigh(cloud: _Cloud, log_weights: np.ndarray, time: float) -> None:
    top = log_weights.max()
    if not np.isfinite(top):
        raise _collapse(time)
    total = top + np.log(np.sum(np.exp(log_weights - top)))
    cloud.log_likelihood += float(total)
    cloud.log_weights = log_weights - total
    cloud.effective.append(float(1.0 / np.sum(np.exp(2.0 * cloud.log_weights))))


def _collapse(time: float) -> EstimationError:
    return EstimationError(
        "particle-collapse",
        f"no particle explains the measurement at t = {time:g}",
        remedy="use more particles or larger noise, check the initial state, or use the ukf",
    )


def systematic(weights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Systematic resampling: as many indices as weights (which sum to 1), with one random number. Shapes:
    weights and indices (m,)."""
    m = weights.size
    places = (rng.uniform() + np.arange(m)) / m
    return np.minimum(np.searchsorted(np.cumsum(weights), places), m - 1)


def _resample(cloud: _Cloud, rng: np.random.Generator) -> None:
    cloud.ancestors = systematic(np.exp(cloud.log_weights), rng)
    cloud.points = cloud.points[cloud.ancestors]
    cloud.log_weights = np.full(cloud.ancestors.size, -np.log(cloud.ancestors.size))


@dataclass(frozen=True)
class Trajectories:
    """States (n_samples, m, n) of m equally weighted trajectories given the whole record. `is_simulated`
    False: the transition has no density, and the trajectories are the ancestral lines of the filter. `rows`
    (n_samples, m): the particles of each sample that they consist of."""

    states: np.ndarray
    is_simulated: bool
    rows: np.ndarray


def smooth_particles(model: PointModel, run: ParticleRun, seed: int | None = None) -> Trajectories:
    """Backward simulation; ancestral lines where the process noise does not reach every state, or particles
    keep more than their state."""
    rng = np.random.default_rng(seed)
    n_samples, m, n = run.points.shape
    count = min(m, MOST_TRAJECTORIES)
    chosen = systematic(run.weights[-1], rng)[rng.permutation(m)[:count]]
    states, rows = np.empty((n_samples, count, n)), np.empty((n_samples, count), dtype=int)
    states[-1], rows[-1] = run.points[-1, chosen], chosen
    if model.has_memory:
        return _ancestral(run, states, rows)
    if n_samples > 1:
        _, roots = model.advance(n_samples - 2, run.points[-2])
        if not np.all(np.diagonal(roots, axis1=1, axis2=2) > 0.0):
            return _ancestral(run, states, rows)
    for k in range(n_samples - 2, -1, -1):
        means, roots = model.advance(k, run.points[k])
        rows[k] = _backward(means, roots, run.weights[k], states[k + 1], rng)
        states[k] = run.points[k, rows[k]]
    return Trajectories(states, True, rows)


def _ancestral(run: ParticleRun, states: np.ndarray, rows: np.ndarray) -> Trajectories:
    for k in range(run.points.shape[0] - 1, 0, -1):
        rows[k - 1] = run.ancestors[k, rows[k]]
        states[k - 1] = run.points[k - 1, rows[k - 1]]
    return Trajectories(states, False, rows)


def _backward(
    means: np.ndarray, roots: np.ndarray, weights: np.ndarray, following: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """For every following state (c, n) one particle, drawn with probability ∝ weight · p(following |
    particle)."""
    usable = np.all(np.isfinite(means), axis=1) & np.all(np.diagonal(roots, axis1=1, axis2=2) > 0, axis=1)
    usable &= weights > 0.0
    inverse = np.linalg.inv(roots[usable])
    m, n, _ = inverse.shape
    white = (inverse.reshape(m * n, n) @ following.T).reshape(m, n, -1)
    white -= inverse @ means[usable, :, None]
    log_det = np.sum(np.log(np.diagonal(inverse, axis1=1, axis2=2)), axis=1)
    log_p = np.log(weights[usable]) + log_det - 0.5 * np.sum(white**2, axis=1).T
    p = np.cumsum(np.exp(log_p - log_p.max(axis=1, keepdims=True)), axis=1)
    draw = rng.uniform(size=(following.shape[0], 1)) * p[:, -1:]
    return np.flatnonzero(usable)[np.argmax(p >= draw, axis=1)]


class ContinuousPoints:
    """A continuous-time model between the samples of a record, as a PointModel: mean and covariance of each
    particle by local linearisation, in as many threads as there are processors."""

    has_memory = False

    def __init__(self, task: Task) -> None:
        self.task, self.start, self._scale = task, task.start, task.scale
        self._n_processors = os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(max_workers=self._n_processors)

    def loop(
        self, outputs: np.ndarray, variance: np.ndarray, start: Start, n_particles: int, proposal: Proposal
    ) -> ParticleLoop | None:
        """The compiled loop over samples; None where `lane_library` has none. Shapes: outputs (n_samples,
        n_y), variance (n_y,)."""
        library = lane_library(self.task.model)
        if library is None:
            return None
        run = Task.of(
            self.task.model,
            replace(self.task.data, outputs=np.ascontiguousarray(outputs, dtype=float)),
            self.task.theta,
            Noise(self.task.noise.intensity, variance),
            start,
            self.task.longest,
        )
        return ParticleLoop(library, run, n_particles, proposal == "ekf", self._pool, self._n_processors)

    def advance(self, k: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        task, data = self.task, self.task.data
        if task.model.library is None:
            means, covs = interpreted.points_advance(task, k, points)
            return means, square_root(covs)
        m, n = points.shape
        means, roots = points.copy(), np.empty((m, n, n))
        library, t, dt = task.model.library, float(data.time[k]), float(data.time[k + 1] - data.time[k])

        def part(rows: slice) -> int:
            return library.daest_points_advance(
                ctypes.c_long(rows.stop - rows.start),
                *map(pointer, (means[rows], roots[rows], data.u0[k], data.u1[k])),
                *map(ctypes.c_double, (t, dt, task.longest)),
                *map(pointer, (task.theta, task.noise.intensity, self._scale)),
            )

        self._all(part, m)
        return means, roots

    def see(self, k: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        task, data = self.task, self.task.data
        m, n = points.shape
        n_y, t = task.model.n_outputs, float(data.time[k])
        if task.model.library is None:
            at = (data.u0[k], task.theta, t)
            h, C = interpreted.evaluate(task.model.see, points, at, [(n_y,), (n_y, n)])
            return h, C
        h, C = np.empty((m, n_y)), np.empty((m, n_y, n))
        points = np.ascontiguousarray(points)
        library = task.model.library

        def part(rows: slice) -> int:
            return library.daest_points_see(
                ctypes.c_long(rows.stop - rows.start),
                *map(pointer, (points[rows], data.u0[k])),
                ctypes.c_double(t),
                *map(pointer, (task.theta, h[rows], C[rows])),
            )

        self._all(part, m)
        return h, C

    def hold(self, k: int, points: np.ndarray) -> np.ndarray:
        task, data = self.task, self.task.data
        if task.model.hold is None:
            return points
        if task.model.library is None:
            return interpreted.points_hold(task, k, points)
        held = np.array(points, order="C")
        status = task.model.library.daest_points_hold(
            ctypes.c_long(points.shape[0]),
            *map(pointer, (held, data.u0[k])),
            ctypes.c_double(float(data.time[k])),
            *map(pointer, (task.theta, self._scale)),
        )
        raise_failure(status, task.model, data, k)
        return held

    def select(self, rows: np.ndarray) -> None:
        pass

    def inside(
        self, k: int, points: np.ndarray, weights: np.ndarray, rows: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (n_v,) of the internal variables at sample k over weighted points."""
        task, data, t = self.task, self.task.data, float(self.task.data.time[k])
        assert task.model.inside is not None
        n_v = task.model.n_inside
        if task.model.library is None:
            (values,) = interpreted.evaluate(task.model.inside, points, (data.u0[k], task.theta, t), [(n_v,)])
            mean = weights @ values
            return mean, np.sqrt(np.maximum(weights @ (values - mean) ** 2, 0.0))
        mean, std = np.empty(n_v), np.empty(n_v)
        points, weights = np.ascontiguousarray(points), np.ascontiguousarray(weights)
        status = task.model.library.daest_points_inside(
            ctypes.c_long(points.shape[0]),
            *map(pointer, (points, weights, data.u0[k])),
            ctypes.c_double(t),
            *map(pointer, (task.theta, mean, std)),
        )
        raise_failure(status, task.model, data, k)
        return mean, std

    def _all(self, part: Callable[[slice], int], m: int) -> None:
        workers = min(self._n_processors, m // SMALLEST_CHUNK)
        if workers <= 1:
            statuses = [part(slice(0, m))]
        else:
            cuts = np.linspace(0, m, workers + 1).astype(int)
            statuses = list(self._pool.map(part, [slice(int(a), int(b)) for a, b in pairwise(cuts)]))
        for status in statuses:
            raise_failure(status, self.task.model, self.task.data, 0)
