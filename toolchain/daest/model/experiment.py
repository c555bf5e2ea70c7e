"""Experiment: one recording, in the model's names and units."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from daest.model.shown import Timed, Trajectories

UNIFORM = 1e-6  # relative deviation of a step from the sampling period
TIME_RESOLUTION = 1e-9  # of written times, relative to the last one


@dataclass(frozen=True)
class Experiment(Timed):
    """A recording of inputs and outputs at strictly increasing times.

    `time` (n_samples,) in seconds; `inputs` (n_samples, n_u) without gaps, in the order of `input_names`
    (model names); `outputs` (n_samples, n_y), NaN where a sample is missing. All in the model's units.
    `extra` keeps the other numeric columns of the file by column name. `period` is the sampling period if it
    is uniform to 1e-6 relative, else None.
    """

    name: str
    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    extra: dict[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # what reading changed: conversions, resampling, detrending

    def __post_init__(self) -> None:
        n = self.time.shape[0]
        if self.inputs.shape != (n, len(self.input_names)):
            raise ValueError(f"inputs have shape {self.inputs.shape}, expected {(n, len(self.input_names))}")
        if self.outputs.shape != (n, len(self.output_names)):
            raise ValueError(
                f"outputs have shape {self.outputs.shape}, expected {(n, len(self.output_names))}"
            )

    @property
    def n_samples(self) -> int:
        return self.time.shape[0]

    @property
    def period(self) -> float | None:
        steps = np.diff(self.time)
        if steps.size == 0:
            return None
        mean = (self.time[-1] - self.time[0]) / steps.size
        tolerance = UNIFORM * mean + TIME_RESOLUTION * abs(self.time[-1])
        return float(mean) if np.all(np.abs(steps - mean) <= tolerance) else None

    def trajectories(self) -> Trajectories:
        values = {
            **dict(zip(self.input_names, self.inputs.T, strict=True)),
            **dict(zip(self.output_names, self.outputs.T, strict=True)),
            **self.extra,
        }
        return Trajectories(self.name, self.time, values, {})
