"""The observer gains of one average linearisation, as a function of noise levels, with exact slopes.

With them the noise levels are unknowns like any others: a search takes parameters, initial states and levels
in one step, where a simplex over the levels would need a run along the record for each trial.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daest.estimation.nonlinear.observer import AverageModel, Observer, observer_of, sampled_average
from daest.model.linear import DiscreteModel
from daest.numerics.exponential import covariance_integral
from daest.numerics.riccati import Gains, NoiseModel, stationary_gain_derivatives

LONGEST_LOG = 30.0  # of a factor of a level: beyond, it is zero or infinite to the record


@dataclass(frozen=True)
class Levels:
    """Noise levels: intensity (n_w,) and measurement standard deviation (n_y,)."""

    intensity: np.ndarray
    measurement_std: np.ndarray

    def times(self, size: float) -> Levels:
        """All variances times `size`."""
        return Levels(self.intensity * size, self.measurement_std * np.sqrt(size))


@dataclass(frozen=True)
class GainFamily:
    """Stationary gains around `levels`: a point is the logs of factors, first of the intensities
    `intensity_free` (indices), then of the standard deviations `std_free`. `unit_covs` (n_w, n, n) are the
    sampled process covariances for intensity 1."""

    sampled: DiscreteModel
    unit_covs: np.ndarray
    levels: Levels
    intensity_free: np.ndarray
    std_free: np.ndarray

    @property
    def n_logs(self) -> int:
        return self.intensity_free.size + self.std_free.size

    def levels_at(self, logs: np.ndarray) -> Levels:
        intensity, std = self.levels.intensity.copy(), self.levels.measurement_std.copy()
        intensity[self.intensity_free] *= np.exp(logs[: self.intensity_free.size])
        std[self.std_free] *= np.exp(logs[self.intensity_free.size :])
        return Levels(intensity, std)

    def at(self, logs: np.ndarray) -> Observer | None:
        """None where there is no gain."""
        levels = self.levels_at(logs)
        model = replace(
            self.sampled,
            process_cov=np.tensordot(levels.intensity, self.unit_covs, 1),
            measurement_cov=np.diag(levels.measurement_std**2),
        )
        return observer_of(model)

    def slopes(self, logs: np.ndarray, found: Observer) -> np.ndarray | None:
        """∂gain/∂logs (n_logs, n, n_y) at `found`; None where the closed loop does not settle."""
        levels, C = self.levels_at(logs), self.sampled.output
        n, n_y = C.shape[1], C.shape[0]
        dQ, dR = np.zeros((self.n_logs, n, n)), np.zeros((self.n_logs, n_y, n_y))
        first = self.intensity_free.size
        dQ[:first] = (levels.intensity[:, None, None] * self.unit_covs)[self.intensity_free]
        for row, j in enumerate(self.std_free):
            dR[first + row, j, j] = 2.0 * levels.measurement_std[j] ** 2
        cross = np.zeros((n, n_y))
        noise = NoiseModel(self.sampled.transition, C, dQ, dR, cross)
        still = NoiseModel(np.zeros_like(dQ), np.zeros((self.n_logs, n_y, n)), dQ, dR, np.zeros((1, n, n_y)))
        predictor = self.sampled.transition @ found.gain
        there = Gains(predictor, found.innovation_cov, found.predicted_cov)
        change = stationary_gain_derivatives(noise, there, still)
        if change is None:
            return None
        along_outputs = change.P @ C.T - found.gain @ change.S
        return along_outputs @ np.linalg.inv(found.innovation_cov)


def gain_family(
    average: AverageModel, levels: Levels, intensity_free: np.ndarray, std_free: np.ndarray
) -> GainFamily | None:
    """The gains of an average linearisation; None where it has none for numbers. `intensity_free` (n_free,)
    and `std_free` (n_free,) are the indices of the levels that are searched."""
    n_w = average.G.shape[1]
    if not np.all(np.isfinite(average.A)):
        return None
    sampled = sampled_average(average, np.zeros(n_w), np.zeros(average.C.shape[0]))
    if not np.all(np.isfinite(sampled.transition)):
        return None
    covs = [covariance_integral(average.A, np.outer(g, g), average.period) for g in average.G.T]
    unit = np.array(covs).reshape(n_w, *average.A.shape)
    if not np.all(np.isfinite(unit)):
        return None
    found = GainFamily(sampled, unit, levels, intensity_free, std_free)
    if average.exact is not None and found.at(np.zeros(found.n_logs)) is None:
        return gain_family(average.exact, levels, intensity_free, std_free)
    return found
