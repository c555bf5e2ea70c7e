"""The compiled loop of the particle filter over the samples of a recording (`numerics/particles.c`)."""

from __future__ import annotations

import ctypes
from concurrent.futures import Executor
from itertools import pairwise

import numpy as np

from daest.estimation.filter_engines.filter_task import NOT_FINITE, Task, raise_failure
from daest.estimation.filter_engines.interpreted import square_root

SMALLEST_SHARE = 4000  # particles per thread: waking one takes as long as hundreds of them
MOST_LANES = 8  # shares begin at multiples of it, so that a vector never holds particles of two
_READ = ("time", "u0", "u1", "y", "theta", "q", "r", "mean", "root")
_FILLED = ("points", "weights", "ancestors", "innovations", "covariances", "log_weights", "seen", "sight")


class _Particles(ctypes.Structure):
    """As in particles.c."""

    _fields_ = (
        ("m", ctypes.c_long),
        *((name, ctypes.c_void_p) for name in _READ),
        ("longest", ctypes.c_double),
        ("is_guided", ctypes.c_int),
        ("z", ctypes.c_void_p),
        *((name, ctypes.c_void_p) for name in _FILLED),
        ("log_likelihood", ctypes.c_double),
        ("effective", ctypes.c_double),
    )


class ParticleLoop:
    """Particles under way, sample by sample: `weigh`, then `follow`.

    points (n_samples, m, n), weights and ancestors (n_samples, m), effective (n_samples,), innovations
    (n_samples, n_y) and covariances (n_samples, n_y, n_y) are as in `ParticleRun`; rows of samples that are
    still to come hold nothing. `is_guided`: the noise is drawn given the measurement.
    """

    def __init__(
        self, library: ctypes.CDLL, task: Task, m: int, is_guided: bool, pool: Executor, n_threads: int
    ) -> None:
        data, n, n_y = task.data, task.start.mean.size, task.model.n_outputs
        n_samples = data.outputs.shape[0]
        self.points = np.empty((n_samples, m, n))
        self.weights = np.empty((n_samples, m))
        self.ancestors = np.empty((n_samples, m), dtype=np.int32)
        self.ancestors[0] = np.arange(m)
        self.effective = np.empty(n_samples)
        self.innovations = np.full((n_samples, n_y), np.nan)
        self.covariances = np.zeros((n_samples, n_y, n_y))
        self._task, self._library, self._pool = task, library, pool
        self._next = np.arange(m, dtype=np.intc)
        root = np.ascontiguousarray(square_root(task.start.cov))
        read: list[np.ndarray] = [data.time, data.u0, data.u1, data.outputs, task.theta]
        read += [task.noise.intensity, task.noise.variance, task.start.mean, root]
        filled: list[np.ndarray] = [self.points, self.weights, self._next, self.innovations, self.covariances]
        filled += [np.full(m, -np.log(m)), np.empty((m, n_y)), np.empty((m, n_y, n))]
        self._arrays = [*read, *filled]  # which the structure points to
        self._run = _Particles(m=m, longest=task.longest, is_guided=is_guided)
        for name, array in zip((*_READ, *_FILLED), self._arrays, strict=True):
            setattr(self._run, name, array.ctypes.data)
        n_shares = max(1, min(n_threads, m // SMALLEST_SHARE))
        cuts = (np.linspace(0, m / MOST_LANES, n_shares + 1).astype(int) * MOST_LANES).tolist()
        self._shares = list(pairwise([*cuts[:-1], m]))

    @property
    def log_likelihood(self) -> float:
        return float(self._run.log_likelihood)

    def weigh(self, k: int, z: np.ndarray, alike: bool) -> bool:
        """Draw the points of sample k with standard normal numbers z (m, n) and weigh them. `alike`: all
        weights were equal before. False where no particle explains the measurement."""
        self._run.z = z.ctypes.data
        if len(self._shares) == 1:
            statuses = [self._draw(k, self._shares[0])]
        else:
            statuses = list(self._pool.map(lambda share: self._draw(k, share), self._shares))
        for status in statuses:
            raise_failure(status, self._task.model, self._task.data, k)
        status = self._library.daest_particles_weigh(
            ctypes.byref(self._run), ctypes.c_long(k), ctypes.c_int(alike)
        )
        self.effective[k] = self._run.effective
        return bool(status != NOT_FINITE)

    def follow(self, k: int, offset: float | None) -> None:
        """Choose the particles that sample k + 1 begins with: drawn anew with the uniform number `offset`,
        None: each follows itself. The row of sample k tells what its points were drawn from."""
        if offset is None:
            self._next[:] = np.arange(self._next.size)
        else:
            self._library.daest_particles_resample(
                ctypes.byref(self._run), ctypes.c_long(k), ctypes.c_double(offset)
            )
        if k + 1 < self.ancestors.shape[0]:
            self.ancestors[k + 1] = self._next

    def _draw(self, k: int, share: tuple[int, int]) -> int:
        first, last = share
        return int(
            self._library.daest_particles_draw(ctypes.byref(self._run), *map(ctypes.c_long, (k, first, last)))
        )
