"""Continuous-discrete extended Kalman filter of an explicit model, and its likelihood with exact derivatives.

Between samples the mean follows the model's linearisation at the current estimate, solved exactly for inputs
that run straight (local linearisation: Jimenez & Ozaki, Int. J. Control 2003; used by CTSM), and the
covariance the average of the linearisations at the two ends: on an affine model this is the Kalman filter.
Substeps no longer than `longest` divide a sample interval; the error is of second order in their length. The
measurements of a sample are taken one after the other, which whitens the innovations.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from daest.estimation.filter_engines import hybrid_filter, interpreted
from daest.estimation.filter_engines.filter_task import Directions, Noise, Record, Start, Task, raise_failure
from daest.numerics.compiler import pointer
from daest.systems.events.event_update import Mode
from daest.systems.simulation.local_linear import LocalModel


@dataclass(frozen=True)
class EkfLikelihood:
    """log p(y) by prediction errors; per sample and output the whitened innovations (n_samples, n_y), zero
    where missing; derivatives of the log-likelihood (d,), of the whitened innovations and of the logarithms
    of their variances (n_samples, d, n_y)."""

    log_likelihood: float
    gradient: np.ndarray
    whitened: np.ndarray
    whitened_slopes: np.ndarray
    log_variance_slopes: np.ndarray

    @property
    def information(self) -> np.ndarray:
        """Fisher information along the directions, Σ ∂ε ∂εᵀ + ½ ∂log s ∂log sᵀ, (d, d)."""
        d = self.gradient.size
        white = self.whitened_slopes.transpose(1, 0, 2).reshape(d, -1)
        logs = self.log_variance_slopes.transpose(1, 0, 2).reshape(d, -1)
        return white @ white.T + 0.5 * logs @ logs.T


@dataclass(frozen=True)
class EkfRun:
    """Predicted and filtered states and covariances per sample, and what a smoother needs.

    innovations, variances (n_samples, n_y): of each output given the ones before it in the sample, NaN where
    missing; sight (n_samples, n_y, n): ∂h/∂x at the prediction; transition (n_samples, n, n):
    ∂x̂(k+1|k)/∂x̂(k|k), at the last sample the identity; noise (n_samples, n, n_w): covariance of the state
    at the end of the interval with the mean of the noise over it; turn (n_samples, n, n): projection of the
    filtered estimate onto invariants of the model, the identity where there are none; modes (n_samples,
    n_theta): parameters with the mode after the measurement, and last_mode, the one at the end; both None for
    a model without events.
    """

    predicted: np.ndarray
    predicted_cov: np.ndarray
    filtered: np.ndarray
    filtered_cov: np.ndarray
    innovations: np.ndarray
    variances: np.ndarray
    sight: np.ndarray
    transition: np.ndarray
    noise: np.ndarray
    turn: np.ndarray
    log_likelihood: float
    modes: np.ndarray | None = None
    last_mode: Mode | None = None


def ekf_likelihood(
    model: LocalModel,
    data: Record,
    theta: np.ndarray,
    noise: Noise,
    start: Start,
    longest: float = np.inf,
    directions: Directions | None = None,
) -> EkfLikelihood:
    """log p(y) with derivatives along `directions`, which need a model built with `tangents`.

    Raises IntegrationError where the model has no finite value, EstimationError `filter-singular-innovation`.
    Shapes: theta (n_theta,); longest [s].
    """
    n, n_y = data.outputs.shape
    d = 0 if directions is None else directions.n
    white, log_variance = np.empty((n, n_y)), np.empty((n, n_y))
    dwhite, dlog = np.empty((n, d, n_y)), np.empty((n, d, n_y))
    call = Task.of(model, data, theta, noise, start, longest)
    run = interpreted.ekf if model.library is None else _compiled_ekf
    run(call, white, log_variance, directions, dwhite, dlog, None)
    gradient = -np.einsum("ki,kdi->d", white, dwhite) - 0.5 * dlog.sum(axis=(0, 2))
    return EkfLikelihood(_log_likelihood(white, log_variance, data), gradient, white, dwhite, dlog)


def run_ekf(
    model: LocalModel,
    data: Record,
    theta: np.ndarray,
    noise: Noise,
    start: Start,
    longest: float = np.inf,
    mode: Mode | None = None,
) -> EkfRun:
    """Filter a recording; errors as `ekf_likelihood`. `mode`: of a model with events, that of the first
    sample, where the filter goes on. Shapes: theta (n_theta,); longest [s]."""
    (samples, n_y), n, n_w = data.outputs.shape, model.n_states, model.n_noises
    shapes = [(n,), (n, n), (n,), (n, n), (n_y,), (n_y,), (n_y, n), (n, n), (n, n_w), (n, n)]
    details = [np.empty((samples, *shape)) for shape in shapes]
    white, log_variance, nothing = (
        np.empty((samples, n_y)),
        np.empty((samples, n_y)),
        np.empty((samples, 0, n_y)),
    )
    call = Task.of(model, data, theta, noise, start, longest)
    modes, last = None, None
    if model.engine is not None:
        modes, last = hybrid_filter.ekf(call, white, log_variance, details, mode)
    else:
        run = interpreted.ekf if model.library is None else _compiled_ekf
        run(call, white, log_variance, None, nothing, nothing, details)
    names = [f.name for f in fields(EkfRun)][: len(details)]
    return EkfRun(
        **dict(zip(names, details, strict=True)),
        log_likelihood=_log_likelihood(white, log_variance, data),
        modes=modes,
        last_mode=last,
    )


def _log_likelihood(white: np.ndarray, log_variance: np.ndarray, data: Record) -> float:
    count = np.isfinite(data.outputs).sum()
    return float(-0.5 * (np.sum(white**2) + np.sum(log_variance) + count * np.log(2 * np.pi)))


def _compiled_ekf(
    call: Task,
    white: np.ndarray,
    log_variance: np.ndarray,
    directions: Directions | None,
    dwhite: np.ndarray,
    dlog: np.ndarray,
    details: list[np.ndarray] | None,
) -> None:
    model, data = call.model, call.data
    assert model.library is not None
    n, d = model.n_states, 0 if directions is None else directions.n
    along: Sequence[np.ndarray | None] = [None] * 5
    if directions is not None:
        parts = (directions.parameters, directions.intensity, directions.variance, directions.mean)
        along = [np.array(p, dtype=float, order="C") for p in parts] + [np.zeros((d, n, n))]
    x, P = call.start.mean.copy(), call.start.cov.copy()
    info = np.zeros(1, dtype=np.int64)
    status = model.library.daest_ekf(
        ctypes.c_long(data.time.size),
        *map(pointer, (data.time, data.u0, data.u1, data.outputs)),
        ctypes.c_double(call.longest),
        *map(pointer, (call.theta, call.noise.intensity, call.noise.variance, call.scale, x, P)),
        *map(pointer, (white, log_variance)),
        ctypes.c_int(d),
        *map(pointer, (*along, dwhite, dlog)),
        *map(pointer, [None] * 10 if details is None else details),
        pointer(info),
    )
    raise_failure(status, model, data, int(info[0]))
