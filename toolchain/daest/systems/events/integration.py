"""What an integration is asked, what it answers, and how it fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from daest.errors import NumericalError

FAILURES = {
    1: "the step size became too small: a singularity, or a discontinuity that is not smoothed",
    2: "{steps} steps lead no farther, the next would be {next:.2g} s long: the model moves much "
    "faster than the record, or is not smooth there",
    3: "the model gives no finite derivative",
    4: "there is not enough memory",
    5: "the constraints of the model depend on each other there",
    6: "after {steps} steps the steps are so short ({next:.2g} s) that the end is out of reach: a "
    "discontinuity that is not smoothed, or a motion much faster than the record",
}


@dataclass(frozen=True)
class Trajectory:
    """states (n_samples, n) and outputs (n_samples, n_y), before the correction of a sample where a gain
    corrects; sensitivities (n_samples, n_y, n_directions): ∂y/∂(chosen parameters, then x0). `modes`
    (n_samples, n_theta): parameters with what keeps its value between events, None without events. `tears`
    (n_samples, n_tears): from which the iterations of the loops at each sample started, NaN from scratch;
    None where none were kept."""

    states: np.ndarray
    outputs: np.ndarray
    sensitivities: np.ndarray
    n_steps: int
    modes: np.ndarray | None = None
    tears: np.ndarray | None = None


@dataclass(frozen=True)
class Correction:
    """Measurements (n_samples, n_y), NaN where missing, and the gain (n_states, n_y), or one per sample
    (n_samples, n_states, n_y), that corrects the state at each sample: x += gain (y - h(x)), where a sensor
    bends what it shows with the error times its relative slope (`sensor_laws`). `gain_slopes`
    (n, n_states, n_y): how it changes along n further directions of the sensitivities."""

    measurements: np.ndarray
    gain: np.ndarray
    gain_slopes: np.ndarray | None = None

    @property
    def slopes(self) -> np.ndarray:
        none = np.zeros((0, *self.gain.shape[-2:]))
        return none if self.gain_slopes is None else np.ascontiguousarray(self.gain_slopes, dtype=float)


@dataclass(frozen=True)
class Run:
    """What every engine needs, checked and contiguous. `directions`: number of sensitivities, 0 for none: the
    first ones `by_parameter`, then those to the initial states, the last ones `by_gain`. `scale`
    (n_states,): sizes of the states."""

    time: np.ndarray
    u0: np.ndarray
    u1: np.ndarray
    u_last: np.ndarray
    bent: np.ndarray | None  # (n_samples - 1, 2, n_ū): see `input_bends`
    theta: np.ndarray
    x0: np.ndarray
    directions: int
    by_parameter: int
    by_gain: int
    rtol: float
    atol: np.ndarray
    scale: np.ndarray
    correction: Correction | None
    max_steps: int
    tell: Callable[[float], object] | None

    @property
    def start_sensitivities(self) -> np.ndarray:
        """∂x0/∂directions (n_states, n_directions): the identity between zeros for parameters and gains."""
        n_states = self.x0.size
        start = np.zeros((n_states, self.directions))
        if self.directions:
            start[:, self.by_parameter : self.by_parameter + n_states] = np.eye(n_states)
        return start


def are_alike(runs: Sequence[Run]) -> bool:
    """Whether runs differ in nothing but their records, their starts and the steps that they may take."""
    one = runs[0]
    return all(other is one or _is_alike(one, other) for other in runs)


def _is_alike(one: Run, other: Run) -> bool:
    if _counts(one) != _counts(other):
        return False
    if not all(_is_same(a, b) for a, b in ((one.theta, other.theta), (one.atol, other.atol))):
        return False
    if one.correction is None or other.correction is None:
        return one.correction is other.correction
    gain, slopes = one.correction.gain, one.correction.gain_slopes
    others = other.correction.gain, other.correction.gain_slopes
    is_same_gain = gain.ndim == others[0].ndim and (gain.ndim == 3 or _is_same(gain, others[0]))
    return is_same_gain and (slopes is others[1] or _is_same(one.correction.slopes, other.correction.slopes))


def _counts(run: Run) -> tuple:
    return run.directions, run.by_parameter, run.by_gain, run.rtol, run.tell, run.bent is None


def _is_same(a: np.ndarray, b: np.ndarray) -> bool:
    return a is b or np.array_equal(a, b)


class IntegrationError(NumericalError):
    """The integration stopped at `time`; a search steps back from such a point instead of giving up."""

    def __init__(self, reason: str, time: float) -> None:
        super().__init__(
            "integration-failed",
            f"The simulation stopped at t = {time:.6g} s: {reason}.",
            remedy="Look at the parameter values and the state then; smooth discontinuities with a width.",
        )
        self.reason, self.time = reason, time

    def __reduce__(self) -> tuple:
        return type(self), (self.reason, self.time)
