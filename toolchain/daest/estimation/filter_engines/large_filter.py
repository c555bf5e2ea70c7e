"""Time-varying filter of a model with many states and an unknown start, in memory that does not grow with the
record.

From the stationary covariance P as reference start the gain K is constant (`estimation.kalman`), and what
the unknown x[0] adds to the prediction of the stationary filter follows x̃[k+1] = (Φ - K C) x̃[k] without any
noise. Its mean, a root of its covariance, and the directions that the outputs have not shown yet are updated
sample by sample, an output at a time: one that sees such a direction makes it known, by the output alone;
else it is J. Potter's square root step. Estimates are reduced to the variables asked for at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from daest.estimation.filter_engines.flat_start import whitening
from daest.estimation.filter_engines.kalman import (
    filtered_moments,
    information_scale,
    observable_first,
)
from daest.estimation.filter_engines.modes import known_parts, modes_of
from daest.estimation.filter_engines.stationary import try_stationary_filter
from daest.estimation.gates import FIT
from daest.model.estimates import FilterKind
from daest.model.experiment import Experiment
from daest.model.linear import DiscreteModel
from daest.numerics.gaussian import FREE_TOLERANCE, quadratic_forms
from daest.numerics.recursions import linear_recursion
from daest.numerics.riccati import unobservable_subspace

MANY_STATES = 100
"""From this many states on: a covariance of each sample would take 80 kB and more."""

SHORTENED = 64
"""Samples after which directions that have died out are left out."""

UNKNOWN = 1e3
"""A standard deviation of this many times the size of a variable says nothing of it. It is not accurate
either: directions that the outputs show by less than `FIT.start_rank` count as not shown."""


@dataclass(frozen=True)
class LargeResult:
    """Estimates of the variables asked for, (n_samples, m) each, NaN and inf where the outputs so far tell
    nothing; the rest as in KalmanResult."""

    values: np.ndarray
    std: np.ndarray
    innovations: np.ndarray
    nis: np.ndarray
    nis_dof: np.ndarray
    log_likelihood: float
    steady_sample: int | None
    unobservable: np.ndarray
    kind: FilterKind = "time-varying"


@dataclass(frozen=True)
class _Unknown:
    """x̃ = mean + root e + free f: e standard normal, f without any prior."""

    mean: np.ndarray
    root: np.ndarray
    free: np.ndarray

    def times(self, matrix: np.ndarray) -> _Unknown:
        n_known = 1 + self.root.shape[1]
        moved = matrix @ np.column_stack([self.mean, self.root, self.free])
        return _Unknown(moved[:, 0], moved[:, 1:n_known], moved[:, n_known:])


def can_stream(
    model: DiscreteModel | Sequence[DiscreteModel], experiment: Experiment
) -> TypeGuard[DiscreteModel]:
    """Whether `large_filter` serves: many states, equal steps, no missing output, a stationary filter."""
    if not isinstance(model, DiscreteModel) or model.transition.shape[0] < MANY_STATES:
        return False
    return not np.any(np.isnan(experiment.outputs)) and try_stationary_filter(model) is not None


def large_filter(
    model: DiscreteModel,
    experiment: Experiment,
    rows: np.ndarray,
    tell: Callable[[str], None] = lambda text: None,
) -> LargeResult:
    """Filtered rows (m, n + n_w) of (x, w̄) with x[0] unknown, where `can_stream`; `tell` is called with
    progress."""
    run = _Run(model, experiment, rows)
    n_samples = run.innovations.shape[0]
    for k in range(n_samples):
        if k % SHORTENED == 0:
            tell(f"filtering ({k} of {n_samples})")
            run.unknown = _shortened(run.unknown, run.scale)
        if run.is_forgotten:
            run.finish(k)
            break
        run.observe(k)
        run.record(k)
        run.unknown = run.unknown.times(run.target.closed_loop)
    return run.result()


def _shortened(unknown: _Unknown, scale: np.ndarray) -> _Unknown:
    """The same by fewer columns, none for directions that have died out."""
    root = _turned(unknown.root, scale, FIT.root_died_out)
    return _Unknown(unknown.mean, root, _turned(unknown.free, scale, FIT.died_out))


def _turned(columns: np.ndarray, scale: np.ndarray, negligible: float) -> np.ndarray:
    """columns times an orthogonal matrix, which brings the large ones to the front, without small ones."""
    if columns.shape[1] == 0:
        return columns
    R, order = scipy.linalg.qr((columns / scale[:, None]).T, mode="r", pivoting=True)
    turned = np.empty((scale.size, min(R.shape)))
    turned[order] = R[: turned.shape[1]].T
    kept = np.linalg.norm(turned, axis=0) > negligible
    return scale[:, None] * turned[:, kept]


class _Run:
    """One filter run: the pass of the stationary filter over the record, what x[0] adds to it, and the
    arrays of the result, which `record` fills."""

    def __init__(self, model: DiscreteModel, experiment: Experiment, rows: np.ndarray) -> None:
        target = try_stationary_filter(model)
        assert target is not None  # `can_stream`
        n, P = model.transition.shape[0], target.predicted_cov
        self.model, self.target = model, target
        self.scale = _state_scale(model, P)
        self.unobservable = unobservable_subspace(model.transition, model.output)[1]
        self.unknown = _Unknown(np.zeros(n), np.zeros((n, 0)), np.diag(self.scale))

        which = np.zeros(experiment.time.size, dtype=np.int64)
        known, drive = known_parts([model], which, experiment)
        z = experiment.outputs - known
        states = linear_recursion(target.closed_loop, z @ target.gain.T + drive, np.zeros(n))[:-1]
        self.white = whitening(target.innovation_cov)
        self.stationary = z - states @ model.output.T
        self.innovations = self.stationary.copy()
        self.nis = np.full(which.size, np.nan)
        self.nis_dof = np.zeros(which.size, dtype=np.int64)
        self.steady_sample: int | None = None

        modes = modes_of([model], which, experiment.outputs)
        gain, cov = filtered_moments(modes, np.zeros(1, dtype=np.int64), P[None], self.white[None])
        self.rows = sp.csr_array(rows)
        self.by_state, self.by_innovation = sp.csr_array(self.rows[:, :n]), self.rows @ gain[0]
        filtered = self.by_state @ states.T + self.by_innovation @ self.stationary.T
        self.values = np.ascontiguousarray(filtered.T)
        self.variance = quadratic_forms(rows, cov)[0]
        self.std = np.broadcast_to(np.sqrt(np.maximum(self.variance, 0.0)), self.values.shape).copy()
        sizes = np.concatenate([self.scale, np.sqrt(np.diagonal(model.noise_cov))])
        self.sizes = abs(self.rows) @ sizes
        self.output_limits = FREE_TOLERANCE * (np.abs(model.output) @ self.scale)

        self._weighted = self.white @ model.output
        self._ahead, self._largest = self._weighted * self.scale, 0.0
        self._n_known, self._log_density = 0, 0.0

    @property
    def is_forgotten(self) -> bool:
        unknown = self.unknown
        dead = bool(np.all(np.abs(unknown.mean) <= FIT.died_out * self.scale))
        return dead and unknown.root.shape[1] == 0 and unknown.free.shape[1] == 0

    def observe(self, k: int) -> None:
        """Update what is known of x̃ with the outputs of sample k."""
        C, unknown = self.model.output, self.unknown
        hidden = np.linalg.norm(C @ unknown.free, axis=1) > self.output_limits
        self.innovations[k] -= C @ unknown.mean
        self.innovations[k, hidden] = np.nan
        if self.steady_sample is None and self._is_steady():
            self.steady_sample = k
        self._largest = max(self._largest, float(np.linalg.norm(self._ahead, axis=1).max()))
        self._ahead = (self._ahead / self.scale) @ self.target.closed_loop * self.scale
        total = 0.0
        for c, value in zip(self._weighted, self.white @ self.stationary[k], strict=True):
            total += self._observe_one(c, value - float(c @ self.unknown.mean))
        if not np.any(hidden):
            self.nis[k], self.nis_dof[k] = total, hidden.size

    def _observe_one(self, c: np.ndarray, innovation: float) -> float:
        """An output c x̃ with unit noise; its squared innovation in standard deviations."""
        unknown = self.unknown
        seen, shares = c @ unknown.free, c @ unknown.root
        size = float(np.linalg.norm(seen))
        if size > FIT.start_rank * self._largest:
            direction = seen.copy()  # the reflection that leaves `seen` in the first column alone
            direction[0] += np.copysign(size, seen[0])
            direction /= np.linalg.norm(direction)
            free = unknown.free - np.outer(unknown.free @ (2.0 * direction), direction)
            gain = free[:, 0] / float(c @ free[:, 0])
            root = np.column_stack([unknown.root - np.outer(gain, shares), gain])
            self.unknown = _Unknown(unknown.mean + gain * innovation, root, free[:, 1:])
            self._n_known += 1
            self._log_density += 0.5 * np.log(2.0 * np.pi) - np.log(size)
            return 0.0
        variance = 1.0 + float(shares @ shares)
        gain = unknown.root @ shares / variance
        root = unknown.root - np.outer(gain / (1.0 + 1.0 / np.sqrt(variance)), shares)
        self.unknown = _Unknown(unknown.mean + gain * innovation, root, unknown.free)
        self._log_density -= 0.5 * (np.log(variance) + innovation**2 / variance)
        return innovation**2 / variance

    def record(self, k: int) -> None:
        """Mean and standard deviation of the rows after the outputs of sample k."""
        unknown = self.unknown
        self.values[k] += self._filtered(unknown.mean)
        self.std[k] = np.sqrt(np.maximum(self.variance + _squares(self._filtered(unknown.root)), 0.0))
        hidden = np.sqrt(_squares(self._filtered(unknown.free))) > FREE_TOLERANCE * self.sizes
        hidden |= self.std[k] > UNKNOWN * self.sizes
        self.values[k, hidden], self.std[k, hidden] = np.nan, np.inf

    def _filtered(self, unknown: np.ndarray) -> np.ndarray:
        """What x̃ adds to the filtered rows: it enters (x, w̄) as x̃ - gain C x̃, and 0 - gain C x̃."""
        return self.by_state @ unknown - self.by_innovation @ (self.model.output @ unknown)

    def _is_steady(self) -> bool:
        """Whether the gain is within `FIT.steady_gain` of the stationary one, in standard deviations."""
        model, target, unknown = self.model, self.target, self.unknown
        if np.any(np.linalg.norm(unknown.free, axis=1) > FREE_TOLERANCE * self.scale):
            return False
        reach = (target.predicted_cov @ model.output.T) + unknown.root @ (model.output @ unknown.root).T
        S = model.output @ reach + model.measurement_cov
        gain = np.linalg.solve(S, (model.transition @ reach + model.cross_cov).T).T
        size = np.sqrt(np.diagonal(target.predicted_cov))
        weight = np.sqrt(np.diagonal(target.innovation_cov)) / np.where(size > 0, size, np.inf)[:, None]
        distance = np.linalg.norm((gain - target.gain) * weight)
        return bool(distance <= FIT.steady_gain * np.linalg.norm(target.gain * weight))

    def finish(self, begin: int) -> None:
        """The samples from `begin` on, which know nothing of the start any more."""
        white = self.stationary[begin:] @ self.white.T
        self.nis[begin:], self.nis_dof[begin:] = np.sum(white**2, axis=1), white.shape[1]
        self._log_density -= 0.5 * float(np.sum(white**2))
        if self.steady_sample is None:
            self.steady_sample = begin

    def result(self) -> LargeResult:
        return LargeResult(
            values=self.values,
            std=self.std,
            innovations=self.innovations,
            nis=self.nis,
            nis_dof=self.nis_dof,
            log_likelihood=self._log_likelihood(),
            steady_sample=self.steady_sample,
            unobservable=self.unobservable,
        )

    def _log_likelihood(self) -> float:
        """log ∫ p(y | x0) dx0 over the observable part of x[0], NaN where the record leaves some open."""
        n_samples, n_y = self.innovations.shape
        p = self.scale.size - self.unobservable.shape[1]
        if self._n_known < p:
            return float("nan")
        observable, _ = unobservable_subspace(self.model.transition, self.model.output)
        basis = observable_first(observable * self.scale)[0][:, :p]
        lengths = np.linalg.svd(self.scale[:, None] * basis, compute_uv=False)
        constant = np.sum(np.log(np.diagonal(self.white))) - 0.5 * n_y * np.log(2.0 * np.pi)
        return float(n_samples * constant + self._log_density + np.sum(np.log(lengths)))


def _state_scale(model: DiscreteModel, P: np.ndarray) -> np.ndarray:
    """The size of every state: its stationary standard deviation, or what a few outputs tell of it alone."""
    size, information = np.sqrt(np.diagonal(P)), information_scale(model)
    return np.where(size > FIT.forgotten_start * information, size, information)


def _squares(columns: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("ij,ij->i", columns, columns))
