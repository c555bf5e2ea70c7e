"""Time stamps that are off: samples that were taken a little before or after the times that are written down.

The error of each sample is then the slope of its output times how far its time is off, so that errors grow
with how fast all outputs change, with one deviation for all of them, and have no memory. No load does that:
what a machine does outlasts a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from daest.diagnosis.evidence.free_starts import free_runs
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, at_fit, period_of
from daest.model.fit import FitResult
from daest.quantities import spoken_duration

TRUE_TIMES = (
    "Write down for every sample the time at which it was taken, or take all by one clock: what is missing "
    "in the machine shows beside that."
)
SHARES = (0.1, 0.5, 0.9)  # of the errors, that time stamps make where the search starts


@dataclass(frozen=True)
class Jitter:
    """Time stamps with errors of the standard deviation `std` [s], a `share` of the sampling period, which
    make the errors of a simulation likelier by `gain` in log-likelihood; they are related to those of the
    sample before by the correlation `memory`."""

    std: float
    share: float
    gain: float
    memory: float

    def told(self, clock: str) -> str:
        """A sentence on it; the times are in seconds, and spoken in the unit `clock`."""
        return (
            " The errors of a simulation grow with how fast the outputs change, and hardly outlast a sample, "
            f"as time stamps make them that are off by {spoken_duration(self.std, clock)} "
            f"({self.share:.2g} of a sample, rms)."
        )

    @property
    def is_shown(self) -> bool:
        is_white = abs(self.memory) < GATES.max_jitter_memory
        return self.gain > GATES.min_jitter_gain and is_white and self.share < GATES.max_jitter


def jitter(null: Null, simulated: FitResult) -> Jitter | None:
    """What time stamps that are off would say of the errors of a simulation of the experiments with the
    parameters of the fit `simulated`; None where the model cannot be simulated, or nothing changes."""
    runs = free_runs(at_fit(null, simulated), null.experiments)
    if runs is None:
        return None
    errors, slopes = [], []
    for experiment, run in zip(null.experiments, runs, strict=True):
        slope = np.gradient(run.outputs, experiment.time, axis=0)
        error = experiment.outputs - run.outputs
        known = np.isfinite(error)
        errors.append(np.where(known, error, 0.0))
        slopes.append(np.where(known, slope, 0.0))
    return _of_errors(np.concatenate(errors), np.concatenate(slopes), period_of(null.experiments))


def _of_errors(errors: np.ndarray, slopes: np.ndarray, period: float) -> Jitter | None:
    """Shapes: errors and slopes of the outputs (n_samples, n_y), zeros where a sample is missing."""
    sizes, speeds = (np.sqrt(np.mean(np.square(part), axis=0)) for part in (errors, slopes))
    moves = (sizes > 0.0) & (speeds > 0.0)
    if not np.any(moves):
        return None
    errors, slopes = errors[:, moves] / sizes[moves], slopes[:, moves] / sizes[moves]
    typical = float(np.mean(np.square(slopes)))

    def surprise(z: np.ndarray) -> float:
        precision, variance = np.exp(-z[:-1]), float(np.exp(z[-1]))
        pull, weight = _seen(errors, slopes, precision)
        told = np.sum(np.square(errors) @ precision) - np.sum(variance * pull**2 / (1.0 + variance * weight))
        return 0.5 * float(told + errors.shape[0] * np.sum(z[:-1]) + np.sum(np.log1p(variance * weight)))

    starts = [
        np.append(np.full(errors.shape[1], np.log(1.0 - share)), np.log(share / typical)) for share in SHARES
    ]
    best = min((minimize(surprise, start, method="L-BFGS-B") for start in starts), key=lambda end: end.fun)
    variance = float(np.exp(best.x[-1]))
    pull, weight = _seen(errors, slopes, np.exp(-best.x[:-1]))
    off = pull / (1.0 + variance * weight)  # how far each time is off, in units of the variance
    std = float(np.sqrt(variance))
    gain = 0.5 * errors.size - float(best.fun)  # beside noise alone, whose size is one
    return Jitter(std, std / period, gain, float(off[1:] @ off[:-1] / (off @ off)) if np.any(off) else 0.0)


def _seen(errors: np.ndarray, slopes: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What errors (n_samples, n_y) say of how far each time is off, and how much they know of it, each
    (n_samples,), beside noises of the outputs of a `precision` (n_y,)."""
    return (errors * slopes) @ precision, np.square(slopes) @ precision
