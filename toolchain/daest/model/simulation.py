"""Simulation: what a model does under given inputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from daest.model.shown import Timed, Trajectories


@dataclass(frozen=True)
class Simulation(Timed):
    """Trajectories at `time` (n_samples,) in seconds, one row per sample, columns in the order of the names.

    `variables` are all internal variables ξ. With noise, `noises` (n_samples, n_w) is the mean of w(t) over
    the interval that a sample starts, `variables` contain it where the model lets w enter directly, and
    `outputs` have measurement noise added; without, `noises` is zero. `method` says how the states were
    computed, `hold` what the inputs do between samples, `seed` what repeats a noisy run.
    """

    model_name: str
    time: np.ndarray
    inputs: np.ndarray
    states: np.ndarray
    outputs: np.ndarray
    variables: np.ndarray
    noises: np.ndarray
    input_names: tuple[str, ...]
    state_names: tuple[str, ...]
    output_names: tuple[str, ...]
    variable_names: tuple[str, ...]
    noise_names: tuple[str, ...]
    units: dict[str, str]  # by name, of everything named above
    hold: Literal["zoh", "foh"]
    method: str
    with_noise: bool = False
    seed: int | None = None

    def __post_init__(self) -> None:
        n = self.time.shape[0]
        for name in ("input", "state", "output", "variable", "noise"):
            values, names = getattr(self, f"{name}s"), getattr(self, f"{name}_names")
            if values.shape != (n, len(names)):
                raise ValueError(f"{name}s have shape {values.shape}, expected {(n, len(names))}")

    @property
    def n_samples(self) -> int:
        return self.time.shape[0]

    def __getitem__(self, name: str) -> np.ndarray:
        """Trajectory (n_samples,) of an output, input, internal variable or state, looked for in this
        order."""
        for kind in ("output", "input", "variable", "state", "noise"):
            names = getattr(self, f"{kind}_names")
            if name in names:
                return getattr(self, f"{kind}s")[:, names.index(name)]
        raise KeyError(name)

    def trajectories(self) -> Trajectories:
        values = {
            **dict(zip(self.variable_names, self.variables.T, strict=True)),
            **dict(zip(self.input_names, self.inputs.T, strict=True)),
            **dict(zip(self.output_names, self.outputs.T, strict=True)),
        }
        return Trajectories(self.model_name, self.time, values, self.units)
