"""Kalman filter steps over many samples: `kalman.c` where there is a C compiler, else the same in numpy."""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np

from daest.numerics.compiler import effort, loaded, pointer, processor_flags, text_of
from daest.numerics.recursions import linear_recursion

# A compiled step with these numbers of states has loops of constant length: the common small models.
CONSTANT = (4,)
WIDEST_FROM = 32  # states from which on the widest vectors of the processor are filled well enough
MOST_LOOPED = 16  # states; products over blocks of samples are faster above
WINDOW = 16  # changes of the covariance that tell how fast they die out, as in kalman.c


@dataclass(frozen=True)
class StepMatrices:
    """Φ, C, Q, S12 (n, n_y) and R of (47), covariance (n_w, n_w) of the noise, and (n_w, n_y) of the noise
    with the outputs: one set per mode, which is the first axis."""

    transition: np.ndarray
    output: np.ndarray
    process_cov: np.ndarray
    cross_cov: np.ndarray
    measurement_cov: np.ndarray
    noise_cov: np.ndarray
    noise_measurement_cov: np.ndarray

    def arrays(self) -> tuple[np.ndarray, ...]:
        """The matrices of all modes in this order."""
        return tuple(vars(self).values())

    def contiguous(self) -> tuple[np.ndarray, ...]:
        return tuple(np.ascontiguousarray(part, dtype=float) for part in self.arrays())


@dataclass(frozen=True)
class Stop:
    """Where a pass ends early: after the first sample whose covariance is stationary to `limit`, in standard
    deviations.

    `after` (n_samples,) bool tells which samples begin enough others of their mode. `targets` (n_modes, n, n)
    are the stationary covariances where `known` (n_modes,) bool; without one the sequence itself tells, by
    how fast its changes die out.
    """

    limit: float
    after: np.ndarray
    targets: np.ndarray
    known: np.ndarray


@dataclass(frozen=True)
class KalmanSteps:
    """The samples that were done (n_done): mean (n) of the prediction, innovations (n_y), sensitivity
    (n, n_columns - 1) of the prediction to the start, S, L⁻¹ of S = L Lᵀ, gain (n, n_y), νᵀ S⁻¹ ν, covariance
    (n, n) of the prediction, and gain (n + n_w, n_y) and covariance of (x, w̄) after the outputs. `after`
    (n, n_columns) and `after_cov` are the prediction that follows. `failed`: the sample whose S has no root;
    `is_stationary`: the last sample ended the pass."""

    predicted: np.ndarray
    innovations: np.ndarray
    sensitivity: np.ndarray
    innovation_cov: np.ndarray
    whitening: np.ndarray
    gain: np.ndarray
    nis: np.ndarray
    cov: np.ndarray
    filter_gain: np.ndarray
    filtered_cov: np.ndarray
    after: np.ndarray
    after_cov: np.ndarray
    failed: int | None = None
    is_stationary: bool = False


def kalman_steps(
    matrices: StepMatrices,
    mode: np.ndarray,
    z: np.ndarray,
    drive: np.ndarray,
    start: np.ndarray,
    cov: np.ndarray,
    *,
    stop: Stop | None = None,
) -> KalmanSteps:
    """The predictor from [m A] = `start` (n, n_columns) and covariance `cov` over outputs z (n_samples, n_y),
    the known drive (n_samples, n) and the modes (n_samples,) of the samples.

    P is updated in Joseph form, [Φ - K C] P [Φ - K C]ᵀ + [I -K] [Q S12; S12ᵀ R] [I -K]ᵀ.
    """
    (n_samples, n_y), n, n_w = z.shape, cov.shape[0], matrices.noise_cov.shape[1]
    size, columns = n + n_w, start.shape[1]
    shapes = [(n,), (n_y,), (n, columns - 1), (n_y, n_y), (n_y, n_y), (n, n_y), ()]
    shapes += [(n, n), (size, n_y), (size, size)]
    results = side_by_side([(n_samples, *shape) for shape in shapes])
    after, after_cov = (np.array(part, dtype=float, order="C") for part in (start, cov))
    stop = stop or Stop(0.0, np.zeros(n_samples, dtype=bool), np.zeros((0, n, n)), np.zeros(0, dtype=bool))
    library = _library(n)
    run = _interpreted if library is None else functools.partial(_compiled, library)
    done = run(matrices, mode, z, drive, after, after_cov, results, stop)
    failed = None if done >= 0 else -1 - done
    count = done if failed is None else failed
    values: list[Any] = [part[:count] for part in results]
    values += [after, after_cov, failed, 0 <= done < n_samples]
    return KalmanSteps(*values)


def side_by_side(shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
    """Arrays of the `shapes`, such as (n_samples, n), without values and parts of one: a large one is made of
    large pages of memory, which are had in a fraction of the time."""
    sizes = [math.prod(shape) for shape in shapes]
    ends = list(accumulate(sizes))
    whole = np.empty(ends[-1])
    return [
        whole[end - size : end].reshape(shape) for end, size, shape in zip(ends, sizes, shapes, strict=True)
    ]


def _compiled(
    library: ctypes.CDLL,
    matrices: StepMatrices,
    mode: np.ndarray,
    z: np.ndarray,
    drive: np.ndarray,
    start: np.ndarray,
    cov: np.ndarray,
    results: list[np.ndarray],
    stop: Stop,
) -> int:
    (n_samples, n_y), (n, columns) = z.shape, start.shape
    known = np.zeros(len(matrices.transition), dtype=np.int8)
    known[: stop.known.size] = stop.known
    whole = np.ascontiguousarray(mode, dtype=np.int64), np.ascontiguousarray(stop.after, dtype=np.int8)
    forces = np.ascontiguousarray(drive) if is_driven(drive) else None
    signals = np.ascontiguousarray(z, dtype=float), forces, np.ascontiguousarray(stop.targets, dtype=float)
    parts = matrices.contiguous()
    outputs: list[np.ndarray | None] = [*results]
    if columns == 1:
        outputs[2] = None
    sizes = (n, n_y, matrices.noise_cov.shape[1], columns, n_samples)
    done: int = library.daest_kalman(
        *map(ctypes.c_long, sizes),
        *map(pointer, (*whole, *parts, *signals, known)),
        ctypes.c_double(stop.limit),
        *map(pointer, (start, cov, *outputs)),
    )
    return done


def _interpreted(
    matrices: StepMatrices,
    mode: np.ndarray,
    z: np.ndarray,
    drive: np.ndarray,
    start: np.ndarray,
    cov: np.ndarray,
    results: list[np.ndarray],
    stop: Stop,
) -> int:
    predicted, innovations, sensitivity, S_all, white_all, gain_all, nis, cov_all, *filtered = results
    settling, is_steady = _Settling(stop.limit), False
    for k, m in enumerate(mode):
        Phi, C, Q, S12, R, *_ = (part[m] for part in matrices.arrays())
        predicted[k], sensitivity[k] = start[:, 0], start[:, 1:]
        PC = cov @ C.T
        S = C @ PC + R
        try:
            white = np.linalg.inv(np.linalg.cholesky(S))
        except np.linalg.LinAlgError:
            return -1 - k
        gain = (Phi @ PC + S12) @ white.T @ white
        seen = -C @ start
        seen[:, 0] += z[k]
        innovations[k], S_all[k], white_all[k], gain_all[k] = seen[:, 0], S, white, gain
        nis[k] = np.sum((white @ seen[:, 0]) ** 2)
        cov_all[k] = cov
        _filtered(matrices, m, cov, PC, white, *(part[k] for part in filtered))
        start[:] = Phi @ start + gain @ seen
        start[:, 0] += drive[k]
        F, cross = Phi - gain @ C, gain @ S12.T
        following = F @ cov @ F.T + Q - cross - cross.T + gain @ R @ gain.T
        following = (following + following.T) / 2
        if not np.all(np.isfinite(following)):
            return -1 - k
        if is_steady:
            cov[:] = following
            return k + 1
        if k + 1 < len(mode) and mode[k + 1] == m and stop.after[k + 1]:
            has_target = bool(stop.known[m]) if stop.known.size else False
            other = stop.targets[m] if has_target else cov
            change = _distance(following, other)
            is_steady = change <= stop.limit if has_target else settling.hears(change)
        else:
            settling = _Settling(stop.limit)
        cov[:] = following
    return len(mode)


@dataclass(frozen=True)
class ConstantGain:
    """Φ - K C (n, n), K (n, n_y), C (n_y, n), L⁻¹ (n_y, n_y) of S = L Lᵀ, and the gain (n + n_w, n_y) of
    (x, w̄) after the outputs."""

    closed_loop: np.ndarray
    gain: np.ndarray
    output: np.ndarray
    whitening: np.ndarray
    filter_gain: np.ndarray

    def over(
        self, z: np.ndarray, drive: np.ndarray, start: np.ndarray, into: tuple[np.ndarray, ...]
    ) -> np.ndarray:
        """The predictor x ← (Φ - K C) x + K z + drive over outputs z (n_samples, n_y) and the known drive
        (n_samples, n): predictions (n_samples, n), innovations (n_samples, n_y), νᵀ S⁻¹ ν (n_samples,) and
        (x, w̄) after the outputs (n_samples, n + n_w) are written `into` these contiguous arrays. Returns the
        state (n,) after them."""
        (n_samples, n_y), n = z.shape, start.size
        library = _library(n) if n <= MOST_LOOPED else None
        if library is None:
            return self._over_blocks(z, drive, start, into)
        signals = [np.ascontiguousarray(z), np.ascontiguousarray(drive) if is_driven(drive) else None]
        after = np.array(start, dtype=float)
        parts = [np.ascontiguousarray(part, dtype=float) for part in vars(self).values()]
        library.daest_constant(
            *map(ctypes.c_long, (n, n_y, self.filter_gain.shape[0], n_samples)),
            *map(pointer, (*parts, *signals, after, *into)),
        )
        return after

    def _over_blocks(
        self, z: np.ndarray, drive: np.ndarray, start: np.ndarray, into: tuple[np.ndarray, ...]
    ) -> np.ndarray:
        predicted, innovations, nis, filtered = into
        total = z @ self.gain.T
        total += drive
        states = linear_recursion(self.closed_loop, total, start)
        predicted[:], innovations[:] = states[:-1], z - states[:-1] @ self.output.T
        nis[:] = np.sum((innovations @ self.whitening.T) ** 2, axis=1)
        filtered[:] = innovations @ self.filter_gain.T
        filtered[:, : start.size] += predicted
        return np.asarray(states[-1])


def is_driven(drive: np.ndarray) -> bool:
    """Whether a known drive (n_samples, n) is more than one zero for all."""
    return any(drive.strides) or bool(np.any(drive[:1]))


def _filtered(
    matrices: StepMatrices,
    mode: int,
    P: np.ndarray,
    PC: np.ndarray,
    white: np.ndarray,
    gain: np.ndarray,
    cov: np.ndarray,
) -> None:
    """Gain and covariance of (x, w̄) after the outputs, written into the arrays; x in Joseph form."""
    n, C, Ne = P.shape[0], matrices.output[mode], matrices.noise_measurement_cov[mode]
    gain[:] = np.vstack([PC, Ne]) @ white.T @ white
    K = gain[:n]
    rest = np.eye(n) - K @ C
    cov[:n, :n] = rest @ P @ rest.T + K @ matrices.measurement_cov[mode] @ K.T
    cov[:n, n:] = -K @ Ne.T
    cov[n:, :n] = cov[:n, n:].T
    cov[n:, n:] = matrices.noise_cov[mode] - gain[n:] @ Ne.T


def _distance(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference in standard deviations of the larger of both covariances."""
    size = np.sqrt(np.maximum(np.maximum(np.diagonal(one), np.diagonal(other)), 0.0))
    apart, scale = np.abs(one - other), np.outer(size, size)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(apart > 0.0, apart / scale, 0.0)
    return float(np.max(share, initial=0.0))


class _Settling:
    """Whether a sequence whose changes are told has come to within `limit` of its end: the largest changes of
    two windows tell how fast they die out, and what all further ones add up to at most."""

    def __init__(self, limit: float) -> None:
        self.limit, self.count, self.now, self.before = limit, 0, 0.0, 0.0

    def hears(self, change: float) -> bool:
        self.now, self.count = max(self.now, change), self.count + 1
        if self.count < WINDOW:
            return False
        ratio = self.now / self.before if self.before > 0.0 else 1.0
        end = WINDOW * self.now * ratio / (1.0 - ratio) if ratio < 1.0 else np.inf
        is_settled = self.now == 0.0 or end <= self.limit
        self.before, self.now, self.count = self.now, 0.0, 0
        return is_settled


@functools.lru_cache(maxsize=8)
def _library(n: int) -> ctypes.CDLL | None:
    """The compiled steps; None without a C compiler."""
    # As fast as -O3, since loops over tiles are written out, and compiled in a third of its time.
    source = text_of("kalman.c")
    flags = (
        effort(source, "-O2"),
        *processor_flags(widest=n >= WIDEST_FROM),
        *((f"-DCONSTANT={n}",) if n in CONSTANT else ()),
    )
    library = loaded(source, "kalman", flags)
    if library is not None:
        library.daest_kalman.restype = ctypes.c_long
        library.daest_constant.restype = None
    return library
