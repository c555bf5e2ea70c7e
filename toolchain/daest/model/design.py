"""Values of a designed experiment: the limits that it keeps, the inputs that were compared, what is
expected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from daest.errors import EstimationError
from daest.model.fit import WeakDirection
from daest.model.holds import Hold
from daest.model.shown import Framed, Listing

Criterion = Literal["D", "A", "worst"]
AimName = Literal["parameters", "rivals", "detect"]
FEWEST_STEPS = 20  # sample intervals of a designed experiment


@dataclass(frozen=True)
class Range:
    """What a variable may reach: low to high, in `unit`; `rate` is the fastest change of an input in unit/s,
    inf where there is no limit."""

    name: str
    unit: str
    low: float
    high: float
    rate: float = np.inf

    @property
    def middle(self) -> float:
        return 0.5 * (self.low + self.high)

    @property
    def rest(self) -> float:
        """The value at which a machine is taken to rest: zero, or the middle of a range without it."""
        return 0.0 if self.low <= 0.0 <= self.high else self.middle

    @property
    def half(self) -> float:
        return 0.5 * (self.high - self.low)


@dataclass(frozen=True)
class Limits:
    """The experiments that are allowed: `inputs` in the order of the model, `safe` ranges of its variables,
    `band` [Hz] of the inputs, `length` and `period` [s].

    Raises EstimationError `design-no-input`, `design-limit` or `design-too-short`.
    """

    inputs: tuple[Range, ...]
    length: float
    period: float
    safe: tuple[Range, ...] = ()
    band: tuple[float, float] = (0.0, np.inf)
    hold: Hold = "foh"
    clock: str = "s"  # unit of the length and the period

    def __post_init__(self) -> None:
        _require_inputs(self.inputs)
        for one in (*self.inputs, *self.safe):
            _require_room(one)
        if not (0.0 < self.period < np.inf and self.length >= FEWEST_STEPS * self.period):
            raise EstimationError(
                "design-too-short",
                f"an experiment of {self.length:.4g} s at a period of {self.period:.4g} s has fewer than "
                f"{FEWEST_STEPS} steps",
                remedy="give a longer --length or a shorter --period",
            )
        if not 0.0 <= self.band[0] < min(self.band[1], self.nyquist):
            raise EstimationError(
                "design-limit",
                f"no frequency lies between {self.band[0]:.4g} Hz and {self.band[1]:.4g} Hz: a period of "
                f"{self.period:.4g} s plays up to {self.nyquist:.4g} Hz",
                remedy="give --band LOW,HIGH with LOW below HIGH and below half the sampling rate",
            )

    @property
    def nyquist(self) -> float:
        return 0.5 / self.period

    @property
    def time(self) -> np.ndarray:
        """(n_samples,) from 0 to the length."""
        return self.period * np.arange(round(self.length / self.period) + 1)


def _require_inputs(inputs: tuple[Range, ...]) -> None:
    if not inputs:
        raise EstimationError(
            "design-no-input",
            "the model has no input: there is nothing that an experiment could play",
            remedy="declare what you can move on the machine as an input of the model",
        )
    if all(one.half == 0.0 for one in inputs):
        raise EstimationError(
            "design-limit",
            f"the limits let no input move: {inputs[0].name} stays at {inputs[0].low:.4g} {inputs[0].unit}",
            remedy="give a range with --limit NAME=LOW,HIGH",
        )


def _require_room(one: Range) -> None:
    if not one.low <= one.high or not one.rate > 0.0:
        raise EstimationError(
            "design-limit",
            f"the limits of {one.name} allow nothing: {one.low:.4g} to {one.high:.4g} {one.unit}"
            + ("" if one.rate > 0.0 else f" at up to {one.rate:.4g} {one.unit}/s"),
            where=one.name,
            remedy="give --limit NAME=LOW,HIGH with LOW below HIGH, and a positive --rate",
        )


@dataclass(frozen=True)
class Played:
    """The best input of one family: `inputs` (n_samples, n_u), None where the family keeps no limit, with the
    `reason`. `value` is what the aim makes of it, `rms` the standard deviation of each input by name."""

    family: str
    shape: str
    value: float
    inputs: np.ndarray | None
    rms: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""


@dataclass(frozen=True)
class Expected:
    """What is expected of one recording. `std_errors` by parameter, None where it does not determine one;
    `log_likelihood_ratio` by pair of rivals, `power` the probability that the aim is reached."""

    value: float
    std_errors: Mapping[str, float | None] = field(default_factory=dict)
    log_likelihood_ratio: Mapping[str, float] = field(default_factory=dict)
    power: float | None = None
    smallest_size: float | None = None


@dataclass(frozen=True)
class PowerPoint:
    """Power, and the smallest size that is seen with the power asked for, of the designed experiment cut or
    repeated to `length` [s] at `amplitude` times its size."""

    length: float
    amplitude: float
    power: float
    smallest_size: float


@dataclass(frozen=True)
class SensorGain:
    """An additional measurement of `variables` (the same but for their sign), with noise of standard
    deviation `std`: what the aim would be with it, and `gain` times better. `closes` tells that it determines
    parameters that no input does without it."""

    variables: tuple[str, ...]
    unit: str
    std: float
    value: float
    gain: float
    closes: bool = False


@dataclass(frozen=True)
class Safety:
    """A variable with a safe range: what it reaches at the parameters of the fit, and the probability that it
    leaves the range, over the uncertainty of the parameters."""

    range: Range
    lowest: float
    highest: float
    probability: float


@dataclass(frozen=True)
class Design(Framed):
    """The result of `design`: the input (time (n_samples,), inputs (n_samples, n_u)) that serves the aim best
    within the limits, what was compared, and what is expected of it.

    `value_of` says what the values of `families`, `present` and `sensors` are; `present` is that of the
    recording that there is, `together` that of both recordings.
    """

    aim: AimName
    message: str
    value_of: str
    higher_is_better: bool
    limits: Limits
    inputs: np.ndarray
    families: tuple[Played, ...]
    expected: Expected
    present: Expected | None
    together: Expected | None
    open_directions: tuple[WeakDirection, ...]
    sensors: tuple[SensorGain, ...]
    safety: tuple[Safety, ...]
    power: tuple[PowerPoint, ...]
    notes: tuple[str, ...]
    seconds: float

    def tables(self) -> tuple[Listing, ...]:
        rows = tuple((p.family, p.shape, p.value, p.reason) for p in self.families)
        return (Listing(self.message, ("family", "shape", self.value_of, "remark"), rows),)
