"""FitResult: what an identification found, how sure it is, and what the data cannot tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from daest.model.holds import Hold
from daest.model.parts import Prior
from daest.model.shown import Framed, Listing

Method = Literal["oe", "pem"]
Status = Literal["converged", "stalled", "iteration limit"]
Bound = Literal["min", "max"]
ProfileEnd = Literal["found", "bound", "open", "failed"]


@dataclass(frozen=True)
class NoiseChoice:
    """What is known of one noise: `value` is the intensity ([unit]² s) of a process noise or the standard
    deviation ([unit]) of a measurement noise, None when unknown; `estimate` None takes the model's choice."""

    value: float | None = None
    estimate: bool | None = None


@dataclass(frozen=True)
class IdentifyOptions:
    """How to identify; None leaves a choice to the model or to the data.

    `estimate` names the parameters to find (None: those that the model marks). `fix` gives other parameters a
    value, `start` start values, `bounds` (min, max) and `prior` in place of the model's. `process_noise` and
    `measurement_noise` are by noise and output name. `hold` None tries foh and zoh and takes the better one.
    `starts` searches from that many start points, seeded by `seed`, in `jobs` processes where that is worth
    while, or on the Dask `cluster` at an address, with the same result; without `second_look` a fit that
    leaves coloured residuals is not tried again from elsewhere, hills beside its end are looked over only
    where they show (of a simulation with `hills`), and the ends of its intervals are not looked at.
    `likelihood` is that of the one-step predictions of a nonlinear model ("pem"): by an observer with a
    constant gain, or by the extended Kalman filter, which suits smooth models and estimates the noise
    exactly. `split` in (0, 1) keeps that first part of every experiment for the estimation and the rest for
    the validation. `profile` names parameters whose profile likelihood is wanted, ("all",) every estimated
    one; the gain of an observer is held in it.
    `shooting` cuts every record of a nonlinear model into that many segments with initial states of their own
    (multiple shooting); None does so for an output-error search that fails over the whole records, 1 never.
    `rtol` is the tolerance of the integration of a nonlinear model (None: that of searches), looser where the
    fit is only to begin another one. A search ends early where it will not come to the log-likelihood
    `least`, below which its end is of no use; one by simulation of a nonlinear model also where a step
    promises less than `enough` of that (None: as little as counts). With `noises_alone` there may be no
    unknown parameter: the noises and initial states are found at the values as they are.
    """

    method: Method | None = None
    estimate: tuple[str, ...] | None = None
    fix: Mapping[str, float] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float | None, float | None]] = field(default_factory=dict)
    prior: Mapping[str, Prior] = field(default_factory=dict)
    process_noise: Mapping[str, NoiseChoice] = field(default_factory=dict)
    measurement_noise: Mapping[str, NoiseChoice] = field(default_factory=dict)
    hold: Hold | None = None
    starts: int = 1
    seed: int = 0
    max_iterations: int = 60
    second_look: bool = True
    hills: bool = False
    likelihood: Literal["observer", "ekf"] = "observer"
    split: float | None = None
    profile: tuple[str, ...] = ()
    shooting: int | None = None
    jobs: int = 1
    cluster: str | None = None
    rtol: float | None = None
    least: float = -np.inf
    enough: float | None = None
    noises_alone: bool = False


@dataclass(frozen=True)
class FittedParameter:
    """One estimated parameter. `std_error` is None where the data do not determine it."""

    name: str
    value: float
    std_error: float | None
    initial: float
    unit: str
    min: float | None
    max: float | None
    at_bound: Bound | None
    prior: Prior | None = None


@dataclass(frozen=True)
class Choice:
    """That an estimate was chosen beside another one: the parameters of that by name, and which share of the
    distance to it the standard errors include."""

    beside: Mapping[str, float]
    share: float

    def of(self, parameter: FittedParameter) -> float:
        """What the standard error of a parameter includes for the choice, in its unit."""
        return self.share * abs(parameter.value - self.beside[parameter.name])


@dataclass(frozen=True)
class FittedNoise:
    """Process noise: `value` is the intensity ([unit]² s). Measurement noise: the standard deviation
    ([unit]). `std_error` is None for a noise that was given, or that the data do not determine.
    """

    name: str
    kind: Literal["process", "measurement"]
    value: float
    std_error: float | None
    unit: str
    estimated: bool
    at_bound: Bound | None


@dataclass(frozen=True)
class FittedInitialState:
    """State at the first sample of one experiment, in the units of the states."""

    experiment: str
    names: tuple[str, ...]
    values: np.ndarray  # (n_states,)
    std_errors: np.ndarray  # (n_states,), NaN where the data do not determine it


@dataclass(frozen=True)
class WeakDirection:
    """Parameters that the data fix only together: multiplying each θ_i by s^weight_i changes the fit little.

    `relative_std` is the standard deviation of log s; 0.5 means: anything from 0.6 to 1.6 times is as good.
    """

    combination: dict[str, float]
    relative_std: float


@dataclass(frozen=True)
class Agreement:
    """Model against data, per output: 100 (1 - |y - ŷ| / |y - mean y|), the rms error in the output's unit,
    and that of the part of the error that has no memory (`white_part`), where it is known.
    """

    fit_percent: dict[str, float | None]
    rms: dict[str, float | None]
    white: dict[str, float | None] = field(default_factory=dict)


def follows_all(simulated: Mapping[str, Agreement], data: str, least: float) -> bool:
    """Whether a simulation of that `data` fits every output by more than `least` percent; not where nothing
    is known of one, or of all."""
    percents = simulated[data].fit_percent.values() if data in simulated else ()
    return bool(percents) and all(percent is not None and percent > least for percent in percents)


def error_ratios(
    before: Mapping[str, Agreement], after: Mapping[str, Agreement], data: str = "validation"
) -> list[float]:
    """The values of `ratios_by_output`."""
    return list(ratios_by_output(before, after, data).values())


def ratios_by_output(
    before: Mapping[str, Agreement], after: Mapping[str, Agreement], data: str = "validation"
) -> dict[str, float]:
    """Error on that `data` relative to what it was, of every output that had one; inf where the new one is
    unknown. Empty without such data."""
    old, new = before.get(data), after.get(data)
    if old is None or new is None:
        return {}
    pairs = [(name, new.rms.get(name), was) for name, was in old.rms.items()]
    return {name: float("inf") if rms is None else rms / was for name, rms, was in pairs if was}


def most_lasting(simulated: Mapping[str, Agreement]) -> tuple[str, float]:
    """The output whose errors in a simulation of unseen data last longest, and how many times their part
    without memory they are; 0 where nothing is known."""
    seen = simulated.get("validation")
    if seen is None:
        return "", 0.0
    pairs = ((name, seen.rms.get(name), white) for name, white in seen.white.items())
    ratios = [(rms / white, name) for name, rms, white in pairs if rms and white]
    ratio, name = max(ratios, default=(0.0, ""))
    return name, ratio


@dataclass(frozen=True)
class Profile:
    """Profile likelihood of one parameter: at `values` (m,), increasing, the log-likelihood re-optimised over
    everything else lies drops / 2 below the best.

    The confidence interval of `level` reaches to where the drop is `threshold`. An end is "found"; or a
    "bound" of the parameter that lies inside; or None and "open", where no value is unlikely enough; or None
    and "failed", where the model cannot be evaluated any further out.
    """

    name: str
    values: np.ndarray
    drops: np.ndarray
    threshold: float
    level: float
    lower: float | None
    upper: float | None
    lower_end: ProfileEnd
    upper_end: ProfileEnd


@dataclass(frozen=True)
class Bootstrap:
    """Refits of recordings that the fitted model itself produced, noise included: `estimates` (n, p) of the
    parameters `names` (p,), without the `n_failed` refits that came to no end. `lower` and `upper` (p,) are
    the percentiles that hold the share `level` of them."""

    names: tuple[str, ...]
    estimates: np.ndarray
    n_failed: int
    level: float
    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True)
class FitResult(Framed):
    """The result of `identify`.

    `theta` holds every parameter of the model by name, estimated or not. `simulated` and `one_step` hold
    "estimation" and, when there are validation data, "validation". `status` "converged" is the only one that
    means that the estimate is a (local) optimum; `message` says what happened and what to try.
    `unseen_states` tells the directions of the state space that no output sees, in words. `choice` is that
    beside another estimate, where the standard errors include one.
    """

    status: Status
    message: str
    method: Method
    parameters: tuple[FittedParameter, ...]
    theta: dict[str, float]
    noises: tuple[FittedNoise, ...]
    noise_model: Literal["white", "held"]
    initial_states: tuple[FittedInitialState, ...]
    correlation_names: tuple[str, ...]
    correlation: np.ndarray
    weak_directions: tuple[WeakDirection, ...]
    weak_threshold: float
    log_likelihood: float
    start_log_likelihoods: tuple[float, ...]  # reached from each start point, best first
    simulated: dict[str, Agreement]
    one_step: dict[str, Agreement]
    n_samples: int
    n_iterations: int
    seconds: float
    period: float | None
    hold: Hold
    notes: tuple[str, ...] = ()
    unseen_states: tuple[str, ...] = ()
    profiles: tuple[Profile, ...] = ()
    bootstrap: Bootstrap | None = None
    choice: Choice | None = None

    @property
    def is_converged(self) -> bool:
        return self.status == "converged"

    def covariance(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Names and covariance (p, p) of the parameters that the data determined. A correlation that is not
        known counts as zero."""
        std = {p.name: p.std_error for p in self.parameters if p.std_error is not None}
        kept = [i for i, name in enumerate(self.correlation_names) if np.isfinite(std.get(name, np.nan))]
        names = tuple(self.correlation_names[i] for i in kept)
        correlation = np.nan_to_num(self.correlation[np.ix_(kept, kept)]) if kept else np.zeros((0, 0))
        np.fill_diagonal(correlation, 1.0)
        sizes = np.array([std[name] for name in names], dtype=float)
        return names, correlation * np.outer(sizes, sizes)

    def tables(self) -> tuple[Listing, ...]:
        columns = ("parameter", "value", "std_error", "unit", "start", "min", "max", "at_bound")
        rows = tuple(
            (p.name, p.value, p.std_error, p.unit, p.initial, p.min, p.max, p.at_bound)
            for p in self.parameters
        )
        parameters = Listing(f"{self.status}: {self.message}", columns, rows)
        return parameters, _agreements(self.simulated, self.one_step)


def _agreements(simulated: Mapping[str, Agreement], one_step: Mapping[str, Agreement]) -> Listing:
    rows = tuple(
        (part, output, fit, agreement.rms[output], one_step[part].fit_percent.get(output))
        for part, agreement in simulated.items()
        for output, fit in agreement.fit_percent.items()
    )
    columns = ("data", "output", "fit %", "rms", "one-step fit %")
    return Listing("Model against data, simulated", columns, rows)
