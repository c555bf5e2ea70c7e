"""What a filter of a nonlinear model is asked to do: a recording, noise sizes and a start, checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daest.errors import EstimationError
from daest.model.estimates import singular_innovation
from daest.model.holds import Hold
from daest.systems.events.integration import IntegrationError
from daest.systems.simulation.integrate import interval_inputs
from daest.systems.simulation.local_linear import LocalModel

NOT_FINITE, NO_MEMORY, SINGULAR_INNOVATION = 3, 4, 5  # as in local_linear.c


@dataclass(frozen=True)
class Record:
    """What a filter reads: time (n_samples,), ū at the two ends of the interval that follows each sample
    (n_samples, n_ū), outputs (n_samples, n_y) with NaN where missing."""

    time: np.ndarray
    u0: np.ndarray
    u1: np.ndarray
    outputs: np.ndarray

    @property
    def steps(self) -> np.ndarray:
        return np.diff(self.time)


@dataclass(frozen=True)
class Noise:
    """`intensity` (n_w,): two-sided spectral densities; `variance` (n_y,): of one sample of each output."""

    intensity: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True)
class Start:
    """Mean (n,) and covariance (n, n) of the state at the first sample, before its measurement."""

    mean: np.ndarray
    cov: np.ndarray


@dataclass(frozen=True)
class Directions:
    """Directions of derivatives, one per row: of the parameters `LocalModel.names` (d, n_p), the intensities
    (d, n_w), the measurement variances (d, n_y), and the initial mean (d, n)."""

    parameters: np.ndarray
    intensity: np.ndarray
    variance: np.ndarray
    mean: np.ndarray

    @property
    def n(self) -> int:
        return self.mean.shape[0]


def record(
    model: LocalModel, time: np.ndarray, inputs: np.ndarray, outputs: np.ndarray, hold: Hold
) -> Record:
    """A recording in the model's order of signals: inputs (n_samples, n_u), outputs (n_samples, n_y). Raises
    EstimationError `data-too-few-rows` below two samples."""
    if time.size < 2:
        raise EstimationError("data-too-few-rows", "a filter needs at least two samples")
    u0, u1 = interval_inputs(model.explicit, time, inputs, hold)
    last = np.hstack([inputs[-1:], u1[-1:, inputs.shape[1] :]])
    parts = (time, np.vstack([u0, last]), np.vstack([u1, last]), outputs)
    return Record(*(np.ascontiguousarray(part, dtype=float) for part in parts))


@dataclass(frozen=True)
class Task:
    """Arguments of a loop over samples, contiguous. Substeps are no longer than `longest` seconds."""

    model: LocalModel
    data: Record
    theta: np.ndarray
    noise: Noise
    start: Start
    longest: float

    @classmethod
    def of(
        cls, model: LocalModel, data: Record, theta: np.ndarray, noise: Noise, start: Start, longest: float
    ) -> Task:
        """The same with copies of all arrays; theta (n_theta,)."""

        def plain(a: np.ndarray) -> np.ndarray:
            return np.array(a, dtype=float, order="C")

        return cls(
            model,
            data,
            plain(theta),
            Noise(plain(noise.intensity), plain(noise.variance)),
            Start(plain(start.mean), plain(start.cov)),
            float(longest),
        )

    @property
    def scale(self) -> np.ndarray:
        """Sizes of the states (n,), by which a projection onto invariants weighs them."""
        nominal = {v.name: v.nominal for v in self.model.explicit.flat.unknowns}
        return np.array([abs(nominal.get(name) or 1.0) for name in self.model.explicit.state_names])


def raise_failure(status: int, model: LocalModel, data: Record, sample: int) -> None:
    """The error behind a status of the compiled loops; none for 0."""
    if status == NO_MEMORY:
        raise MemoryError("no memory for the work arrays of a filter")
    time = float(data.time[min(sample, data.time.size - 1)])
    if status == SINGULAR_INNOVATION:
        raise singular_innovation(f"at t = {time:g} s")
    if status:
        raise IntegrationError("the model gives no finite derivative or output", time)
