"""Recordings in the names and units of a model, simulations, and what a look at a recording found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from daest.model.holds import Hold
from daest.model.shown import Framed, Listing, Timed, Trajectories
from daest.quantities import Conversion

UNIFORM = 1e-6  # relative deviation of a step from the sampling period
TIME_RESOLUTION = 1e-9  # of written times, relative to the last one


@dataclass(frozen=True)
class Experiment(Timed):
    """A recording of inputs and outputs at strictly increasing times.

    `time` (n_samples,) in seconds; `inputs` (n_samples, n_u) without gaps, in the order of `input_names`
    (model names); `outputs` (n_samples, n_y), NaN where a sample is missing. All in the model's units.
    `extra` keeps the other numeric columns of the file by column name, `extra_units` their units where the
    file tells them. `read_by` says what made the values of signals of the numbers in their columns, where
    that is not known to be nothing. `period` is the sampling period if it is uniform to 1e-6 relative, else
    None.
    """

    name: str
    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    extra: dict[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # what reading changed: conversions, resampling, detrending
    extra_units: dict[str, str] = field(default_factory=dict)
    read_by: dict[str, Conversion] = field(default_factory=dict)

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

    def input(self, name: str) -> np.ndarray:
        """The course (n_samples,) of one input."""
        return self.inputs[:, self.input_names.index(name)]

    def output(self, name: str) -> np.ndarray:
        """The course (n_samples,) of one output, NaN where a sample is missing."""
        return self.outputs[:, self.output_names.index(name)]

    def inputs_of(self, names: Sequence[str]) -> np.ndarray:
        """The inputs `names` (n_samples, n_names), in that order."""
        return self.inputs[:, [self.input_names.index(name) for name in names]]

    def outputs_of(self, names: Sequence[str]) -> np.ndarray:
        """The outputs `names` (n_samples, n_names), in that order."""
        return self.outputs[:, [self.output_names.index(name) for name in names]]

    def first(self, n: int) -> Experiment:
        """The first `n` samples at most, without `extra`."""
        return replace(self, time=self.time[:n], inputs=self.inputs[:n], outputs=self.outputs[:n], extra={})

    def driven_by(self, names: Sequence[str]) -> Experiment:
        """The recording with columns of `extra` as further inputs, zero where they hold no value; `names` of
        inputs that it has are there already."""
        new = [name for name in names if name not in self.input_names]
        inputs = np.column_stack([self.inputs, *(np.nan_to_num(self.extra[name]) for name in new)])
        return replace(self, inputs=inputs, input_names=(*self.input_names, *new))

    def signal(self, name: str) -> np.ndarray:
        """Values (n_samples,) of an input or of a column of `extra`, zero where that holds no value."""
        return self.input(name) if name in self.input_names else np.nan_to_num(self.extra[name])

    def as_driving(self, names: Sequence[str]) -> Experiment:
        """The recording with the inputs `names` alone, in that order: those that it has and columns of
        `extra`."""
        whole = self.driven_by(names)
        chosen = [whole.input_names.index(name) for name in names]
        return replace(whole, inputs=whole.inputs[:, chosen], input_names=tuple(names))

    @property
    def period(self) -> float | None:
        steps = np.diff(self.time)
        if steps.size == 0:
            return None
        mean = (self.time[-1] - self.time[0]) / steps.size
        tolerance = UNIFORM * mean + TIME_RESOLUTION * abs(self.time[-1])
        return float(mean) if np.all(np.abs(steps - mean) <= tolerance) else None

    @property
    def median_step(self) -> float:
        """Between two samples [s]; NaN where there are no two."""
        return float(np.median(np.diff(self.time))) if self.time.size > 1 else float("nan")

    def trajectories(self) -> Trajectories:
        values = {
            **dict(zip(self.input_names, self.inputs.T, strict=True)),
            **dict(zip(self.output_names, self.outputs.T, strict=True)),
            **self.extra,
        }
        return Trajectories(self.name, self.time, values, {})


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
    hold: Hold
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


Level = Literal["warning", "note"]
Role = Literal["input", "output"]


@dataclass(frozen=True)
class Finding:
    """One thing that was seen. A `warning` is probably a fault of the recording, a `note` something to know.

    `code` is explained by `daest explain`; `column` is None for what concerns no single one; `at` is the
    first time (s) and `count` how many samples, runs or steps there are. `text` is a sentence without its
    subject, which is the column, else `subject`.
    """

    code: str
    level: Level
    column: str | None
    text: str
    at: float | None = None
    count: int = 1
    subject: str = "the clock"

    @property
    def sentence(self) -> str:
        """The text with its subject."""
        return f"{self.column or self.subject} {self.text}"


@dataclass(frozen=True)
class ColumnSummary:
    """A column in numbers: `resolution` is the step of its values where they stand on a lattice, `noise` the
    standard deviation of white noise where it shows, both in the unit of the column, else None."""

    name: str
    unit: str | None
    role: Role | None
    n_values: int
    low: float | None
    high: float | None
    resolution: float | None
    noise: float | None


@dataclass(frozen=True)
class DataCheck(Framed):
    """A recording, its times (`start`, `stop` and `period`, None where uneven, in `clock`) and what was
    found."""

    name: str
    n_samples: int
    start: float
    stop: float
    period: float | None
    columns: tuple[ColumnSummary, ...]
    findings: tuple[Finding, ...]
    clock: str = "s"

    @property
    def warnings(self) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.level == "warning")

    def tables(self) -> tuple[Listing, ...]:
        title = f"{self.name}: {self.n_samples} samples, {self.start:.6g} to {self.stop:.6g} {self.clock}"
        rows = tuple((f.code, f.level, f.column, f.sentence, f.at, f.count) for f in self.findings)
        return (Listing(title, ("code", "level", "column", "text", "time", "count"), rows),)
