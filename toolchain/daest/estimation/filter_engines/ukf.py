"""Continuous-discrete unscented Kalman filter: scaled sigma points, additive noise.

The sigma points (Julier & Uhlmann 2004; van der Merwe 2004) of the state are carried over a sample interval
by local linearisation on substeps, each along its own path; the process noise that is added is that of the
path of the mean. On an affine model this is the Kalman filter.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, fields

import numpy as np

from daest.estimation.filter_engines import hybrid_filter, interpreted
from daest.estimation.filter_engines.filter_task import Noise, Record, Start, Task, raise_failure
from daest.numerics.compiler import pointer
from daest.systems.events.event_update import Mode
from daest.systems.simulation.local_linear import LocalModel


@dataclass(frozen=True)
class SigmaPoints:
    """Scaled sigma points: `alpha` spreads them, `beta` = 2 suits a Gaussian, `kappa` None is 3 - n for fewer
    than three states (fourth moments right) and 0 otherwise (no negative weight)."""

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float | None = None

    def weights(self, n: int) -> np.ndarray:
        """Distance of the points in standard deviations; weight of the centre in the mean and in the
        covariance; weight of every other point. Shapes: (4,)."""
        kappa = max(3.0 - n, 0.0) if self.kappa is None else self.kappa
        total = self.alpha**2 * (n + kappa)
        centre = 1.0 - n / total
        return np.array([np.sqrt(total), centre, centre + 1.0 - self.alpha**2 + self.beta, 0.5 / total])


@dataclass(frozen=True)
class UkfRun:
    """Predicted and filtered states and covariances per sample.

    innovations (n_samples, n_y), NaN where missing, with covariances (n_samples, n_y, n_y); nis (n_samples,):
    normalised squares; cross (n_samples, n, n): covariance of the filtered state with the next predicted one;
    noise (n_samples, n, n_w): covariance of the state at the end of the interval with the mean of the noise;
    modes as in `ekf.EkfRun`.
    """

    predicted: np.ndarray
    predicted_cov: np.ndarray
    filtered: np.ndarray
    filtered_cov: np.ndarray
    innovations: np.ndarray
    innovation_cov: np.ndarray
    log_density: np.ndarray
    nis: np.ndarray
    cross: np.ndarray
    noise: np.ndarray
    modes: np.ndarray | None = None
    last_mode: Mode | None = None

    @property
    def log_likelihood(self) -> float:
        return float(self.log_density.sum())


def run_ukf(
    model: LocalModel,
    data: Record,
    theta: np.ndarray,
    noise: Noise,
    start: Start,
    longest: float = np.inf,
    points: SigmaPoints | None = None,
    mode: Mode | None = None,
) -> UkfRun:
    """Filter a recording with substeps no longer than `longest` seconds; `mode` as in `run_ekf`.

    Raises IntegrationError where the model has no finite value at a sigma point, EstimationError
    `filter-singular-innovation`. Shapes: theta (n_theta,).
    """
    (samples, n_y), n, n_w = data.outputs.shape, model.n_states, model.n_noises
    shapes = [(n,), (n, n), (n,), (n, n), (n_y,), (n_y, n_y), (), (), (n, n), (n, n_w)]
    tables = [np.zeros((samples, *shape)) for shape in shapes]
    task = Task.of(model, data, theta, noise, start, longest)
    weights = (points or SigmaPoints()).weights(n)
    modes, last = None, None
    if model.engine is not None:
        modes, last = hybrid_filter.ukf(task, weights, tables, mode)
    else:
        (interpreted.ukf if model.library is None else _compiled)(task, weights, tables)
    names = [f.name for f in fields(UkfRun)][: len(tables)]
    return UkfRun(**dict(zip(names, tables, strict=True)), modes=modes, last_mode=last)


def _compiled(task: Task, weights: np.ndarray, tables: list[np.ndarray]) -> None:
    library, data = task.model.library, task.data
    assert library is not None
    x, P = task.start.mean.copy(), task.start.cov.copy()
    info = np.zeros(1, dtype=np.int64)
    status = library.daest_ukf(
        ctypes.c_long(data.time.size),
        *map(pointer, (data.time, data.u0, data.u1, data.outputs)),
        ctypes.c_double(task.longest),
        *map(pointer, (task.theta, task.noise.intensity, task.noise.variance, task.scale, x, P, weights)),
        *map(pointer, (*tables, info)),
    )
    raise_failure(status, task.model, data, int(info[0]))
