"""Estimates: what a filter or a smoother returns, from arrays by sample to named internal variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from daest.errors import EstimationError
from daest.model.defaults import PARTICLES
from daest.model.holds import Hold
from daest.model.linear import DiscreteModel
from daest.model.shown import Timed, Trajectories

FilterKind = Literal["time-varying", "stationary"]


@dataclass(frozen=True)
class Varying:
    """One array per sample, stored once where samples share it: sample k has `distinct[index[k]]`.

    A stationary phase of a million samples is one entry of `distinct`.
    """

    distinct: np.ndarray  # (n_distinct, ...)
    index: np.ndarray  # (n_samples,), integer

    def __len__(self) -> int:
        return self.index.shape[0]

    def __getitem__(self, k: int) -> np.ndarray:
        return self.distinct[self.index[k]]

    def array(self) -> np.ndarray:
        """All samples written out, shape (n_samples, ...)."""
        return self.distinct[self.index]


@dataclass(frozen=True)
class GaussianSequence:
    """A Gaussian vector per sample, of which some directions may still be undetermined.

    mean (n_samples, n); cov Varying (n, n); `free` Varying (n, q): directions in which the data have said
    nothing yet, zero columns where nothing is free. Along a free direction `mean` is one of infinitely many
    values and `cov` is meaningless, so read single components through `numerics.gaussian.marginals`, which
    gives NaN and inf there. `scale` (n,) is the size against which a free direction counts as zero.
    """

    mean: np.ndarray
    cov: Varying
    free: Varying
    scale: np.ndarray


@dataclass(frozen=True)
class InitialState:
    """x[0] before any measurement: mean (n,) and covariance (n, n). A state with infinite variance is
    unknown: flat prior, its mean does not matter and its covariances with other states must be zero."""

    mean: np.ndarray
    cov: np.ndarray

    @classmethod
    def unknown(cls, n: int) -> InitialState:
        return cls(np.zeros(n), np.diag(np.full(n, np.inf)))

    @classmethod
    def known(cls, mean: np.ndarray, std: np.ndarray | float = 0.0) -> InitialState:
        mean = np.asarray(mean, dtype=float)
        return cls(mean, np.diag(np.broadcast_to(np.asarray(std, dtype=float) ** 2, mean.shape)))

    @property
    def is_unknown(self) -> np.ndarray:
        """Which states have a flat prior, (n,) bool."""
        return np.isinf(np.diagonal(self.cov))


@dataclass(frozen=True)
class FilterOptions:
    """How a recording is filtered. Arrays are in the order of the model; None takes the model's own numbers.

    theta (n_parameters,); `process_intensity` (n_w,) or (n_w, n_w): two-sided spectral densities of the white
    noises; `measurement_cov` (n_y,) variances or (n_y, n_y) covariance of one sample of the measurement
    noises. `measure` names the outputs to use (None: all that were recorded); the other recorded outputs are
    compared with their estimates. `smooth` estimates from the whole record in place of the past.

    `initial` is the state at the first sample, in the states of the model; None, or an infinite variance, is
    unknown: a flat prior for the time-varying filter, zero for the stationary one, and for nonlinear filters
    a wide one around a first smoothed estimate. `n_particles`, `seed` and `proposal` are for a particle
    filter. `longest`: of the substeps of a nonlinear filter, seconds (None: found by halving). `compiled`
    False computes without a C compiler.
    """

    theta: np.ndarray | None = None
    process_intensity: np.ndarray | None = None
    measurement_cov: np.ndarray | None = None
    measure: Sequence[str] | None = None
    smooth: bool = False
    initial: InitialState | None = None
    hold: Hold = "foh"
    n_particles: int = PARTICLES
    seed: int | None = None
    proposal: Literal["bootstrap", "ekf"] = "ekf"
    longest: float | None = None
    compiled: bool = True


@dataclass(frozen=True)
class NisSummary:
    """Normalised innovations squared νᵀ S⁻¹ ν, summed and divided by the number of scalar innovations: 1 is
    expected.

    `low` and `high` bound 95 % of the values that a true model would give (chi-square with `n_innovations`
    degrees of freedom).
    """

    mean: float
    low: float
    high: float
    n_innovations: int

    @property
    def inside(self) -> bool:
        return self.low <= self.mean <= self.high


@dataclass(frozen=True)
class Modes:
    """The matrices of (47), one set per combination of model (step length) and present outputs; first axis
    n_modes.

    Rows of missing outputs are zero in `output`, `cross_cov` and `noise_measurement_cov` and unit rows in
    `measurement_cov`: with a zero innovation they carry no information. Fields as in DiscreteModel.
    """

    transition: np.ndarray
    output: np.ndarray
    process_cov: np.ndarray
    cross_cov: np.ndarray
    measurement_cov: np.ndarray
    noise_cov: np.ndarray
    noise_process_cov: np.ndarray
    noise_measurement_cov: np.ndarray
    present: np.ndarray  # (n_modes, n_y) bool
    model: np.ndarray  # (n_modes,) which model
    index: np.ndarray  # (n_samples,) mode of each sample


@dataclass(frozen=True)
class FilterPass:
    """One forward pass from a reference start, with the sensitivity of everything to the unknown part δ of
    x[0].

    x[0] = start + A[0] δ: the predicted state is m + A δ and the innovation ν - V δ. `cov`, `innovation_cov`,
    `gain` and `mode` hold distinct values, sample k has entry `index[k]`. A and V are kept for the first
    n_kept samples; after them they are zero to rounding.
    """

    modes: Modes
    predicted: np.ndarray  # m, (n_samples, n)
    innovations: np.ndarray  # ν, (n_samples, n_y), zero where a sample is missing
    nis: np.ndarray  # νᵀ S⁻¹ ν, (n_samples,)
    filtered: np.ndarray  # (x[k], w̄[k]) given y up to k for δ = 0, (n_samples, n + n_w)
    index: np.ndarray  # (n_samples,)
    cov: np.ndarray  # P[k|k-1] for known δ, (n_distinct, n, n)
    innovation_cov: np.ndarray  # S, (n_distinct, n_y, n_y); unit rows where an output is missing
    whitening: np.ndarray  # L⁻¹ of S = L Lᵀ, (n_distinct, n_y, n_y)
    gain: np.ndarray  # (Φ P Cᵀ + S12) S⁻¹, (n_distinct, n, n_y)
    filter_gain: np.ndarray  # [P Cᵀ; R12] S⁻¹ for (x[k], w̄[k]), (n_distinct, n + n_w, n_y)
    filtered_cov: (
        np.ndarray
    )  # covariance of (x[k], w̄[k]) given y up to k for known δ, (n_distinct, n + n_w, …)
    mode: np.ndarray  # (n_distinct,)
    sensitivity: np.ndarray  # A, (n_kept, n, q)
    innovation_sensitivity: np.ndarray  # V = C A, (n_kept, n_y, q)
    n_observable: int  # the first columns of A; the others never reach an output
    stationary_from: int | None  # first sample of a phase with constant gain


@dataclass(frozen=True)
class FlatStart:
    """What the outputs up to and including sample k say about δ: δ ~ N(mean[k], factor[k] factor[k]ᵀ) but for
    the directions `free[k]`, about which they say nothing. First axis n_kept."""

    mean: np.ndarray  # (n_kept, q)
    factor: np.ndarray  # (n_kept, q, q)
    free: np.ndarray  # (n_kept, q, q), zero columns where nothing is free


@dataclass(frozen=True)
class KalmanResult:
    """Time-varying or stationary filter of (47).

    `predicted` is x[k] given the outputs before k; `filtered` is (x[k], w̄[k]) given the outputs up to k: the
    process noise estimate (54) is its last n_w components. `innovations` (n_samples, n_y) are NaN where an
    output is missing or not yet predictable; `innovation_cov` belongs to them. `nis` (n_samples,) with
    `nis_dof` present outputs, NaN and 0 where there is none. `log_likelihood` is log p(y), and log ∫ p(y |
    x0) dx0 over the unknown states that the outputs determine, NaN when the record is too short for them.
    `stationary_from` is the first sample from which the gain for a known start is constant (None: never); an
    unknown start adds a vanishing part.
    """

    kind: FilterKind
    time: np.ndarray
    predicted: GaussianSequence
    filtered: GaussianSequence
    innovations: np.ndarray
    innovation_cov: Varying
    nis: np.ndarray
    nis_dof: np.ndarray
    log_likelihood: float
    stationary_from: int | None
    observed: DiscreteModel  # the sampled model with the outputs that are ever present
    forward: FilterPass
    flat_start: FlatStart
    scale: np.ndarray  # (n + n_w,), sizes of x and w̄


@dataclass(frozen=True)
class SmootherResult:
    """(x[k], w̄[k]) given all outputs of the record; the last n_w components are the process noise, which has
    no estimate at the last sample beyond its prior unless it reaches an output directly."""

    time: np.ndarray
    smoothed: GaussianSequence


@dataclass(frozen=True)
class OutputComparison:
    """A measured output that was not used, against its estimate: fit 100 (1 - ||y - ŷ|| / ||y - mean y||) in
    percent and the root mean square error in the unit of the output, over `n_samples` samples: those whose
    standard deviation is below the spread of the whole signal (an unknown start is uncertain without bound).
    NaN when nothing can be compared."""

    fit_percent: float
    rms: float
    n_samples: int


@dataclass(frozen=True)
class ProcessNoiseEstimate:
    """w̄[k], the mean of each white noise over the sample that starts at `time[k]`; arrays (n_samples,
    n_w)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class FilterResult(Timed):
    """Every internal variable of a model with its standard deviation, from a recording.

    values and std (n_samples, n_ξ) in `units`, one column per entry of `names` (all unknowns of the model,
    then the outputs that are no unknowns, without measurement noise); value NaN and std inf where the data do
    not determine a variable. `measure` are the outputs that were used; `compared` holds every other measured
    output. `steady_after` is the time in seconds until the gain is within 1 % of the stationary gain, None if
    it never is. `effective_sample_size` (n_samples,): of a particle filter. `messages` are sentences for the
    user: what was decided, and what cannot be estimated.
    """

    kind: str
    smoothed: bool
    names: tuple[str, ...]
    units: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray
    std: np.ndarray
    output_names: tuple[str, ...]  # the used ones, the columns of `innovations`
    innovations: np.ndarray
    nis: NisSummary
    log_likelihood: float
    measure: tuple[str, ...]
    compared: dict[str, OutputComparison]
    process_noise: ProcessNoiseEstimate
    steady_after: float | None
    noise: Literal["white", "held"]
    hold: Hold
    messages: tuple[str, ...] = ()
    effective_sample_size: np.ndarray | None = None

    def trajectories(self) -> Trajectories:
        columns = {
            **dict(zip(self.names, self.values.T, strict=True)),
            **{f"{name}.std": std for name, std in zip(self.names, self.std.T, strict=True)},
        }
        units = dict(zip(self.names, self.units, strict=True))
        units.update({f"{name}.std": unit for name, unit in list(units.items())})
        kind = f"{self.kind} {'smoother' if self.smoothed else 'filter'}"
        return Trajectories(kind, self.time, columns, units)


@dataclass(frozen=True)
class Sample:
    """One line of a stream: time in seconds, inputs (n_u,) and outputs (n_y,) in the order and the units of
    the model; NaN marks a missing output."""

    time: float
    inputs: np.ndarray
    outputs: np.ndarray


@dataclass(frozen=True)
class Estimate:
    """What is known after one sample.

    `values`, `std` (n_v,) of the filter's `names`: NaN and inf where the outputs so far say nothing.
    `innovations` (n_y,): output minus its prediction from the past, NaN where it is missing or could not be
    predicted; `whitened` (n_y,): the same with unit covariance, each output given those before it. `nis` is
    the sum of the squares of `whitened` over `nis_dof` outputs. `log_likelihood`: of all samples so far, NaN
    until they determine the unknown start.
    """

    time: float
    values: np.ndarray
    std: np.ndarray
    innovations: np.ndarray
    whitened: np.ndarray
    nis: float
    nis_dof: int
    log_likelihood: float


def singular_innovation(where: str) -> EstimationError:
    """The error of a filter whose innovations have no regular covariance; `where` tells the sample."""
    return EstimationError(
        "filter-singular-innovation",
        f"an output can be predicted without error {where}: neither it nor the states have noise",
        remedy="give every measured output a noise with a standard deviation above zero",
    )
