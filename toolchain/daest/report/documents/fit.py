"""The document of `daest identify`: JSON content of a FitResult."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import numpy as np

from daest.model.fit import (
    Bootstrap,
    Bound,
    FitResult,
    FittedNoise,
    Method,
    ProfileEnd,
)
from daest.report.documents.parts import ByPart, Errors, entry, errors_entry


class PriorEntry(TypedDict):
    mean: float
    std: float


class ParameterEntry(TypedDict):
    value: float
    std_error: float | None
    initial: float
    unit: str
    min: float | None
    max: float | None
    at_bound: Bound | None
    prior: NotRequired[PriorEntry | None]


class FittedNoiseEntry(TypedDict):
    std_error: float | None
    unit: str
    estimated: bool
    at_bound: Bound | None


class ProcessNoiseEntry(FittedNoiseEntry):
    intensity: float


class MeasurementNoiseEntry(FittedNoiseEntry):
    std: float


class NoiseEntry(TypedDict):
    process: dict[str, ProcessNoiseEntry]
    measurement: dict[str, MeasurementNoiseEntry]


class StateEntry(TypedDict):
    value: float | None
    std_error: float | None


class Correlation(TypedDict):
    names: list[str]
    matrix: list[list[float | None]]


class WeakDirectionEntry(TypedDict):
    combination: dict[str, float]
    relative_std: float | None


class ProfileEntry(TypedDict):
    level: float
    lower: float | None
    upper: float | None
    lower_end: ProfileEnd
    upper_end: ProfileEnd
    threshold: float
    values: list[float]
    drops: list[float]


class Spread(TypedDict):
    lower: float
    upper: float
    mean: float
    std: float


class BootstrapEntry(TypedDict):
    level: float
    n: int
    n_failed: int
    parameters: dict[str, Spread]


class FitDocument(TypedDict):
    """Parameters with their uncertainty."""

    status: str
    message: str
    method: Method
    parameters: dict[str, ParameterEntry]
    theta: Annotated[dict[str, float], "all parameters of the model"]
    noise: NoiseEntry
    noise_model: NotRequired[Literal["white", "held"]]
    initial_state: Annotated[dict[str, dict[str, StateEntry]], "by recording"]
    correlation: Correlation
    weak_directions: list[WeakDirectionEntry]
    weak_threshold: NotRequired[float]
    log_likelihood: float | None
    start_log_likelihoods: NotRequired[list[float | None]]
    fit_percent: ByPart
    rms: ByPart
    one_step: Errors
    n_samples: int
    n_iterations: NotRequired[int]
    seconds: float
    period: float | None
    hold: Literal["zoh", "foh"]
    notes: NotRequired[list[str]]
    unseen_states: NotRequired[
        Annotated[
            list[str],
            "Directions of the state space that no output sees and that do not die out, such as a common "
            "angle where only a speed is measured; their start is left open",
        ]
    ]
    profiles: NotRequired[
        Annotated[
            dict[str, ProfileEntry],
            "Profile likelihoods by parameter: drops of 2 log L over values; the interval of level reaches "
            "to where the drop is threshold",
        ]
    ]
    bootstrap: NotRequired[
        Annotated[
            BootstrapEntry | None,
            "Refits of recordings that the fitted model itself made, noise included: percentile intervals of "
            "level by parameter",
        ]
    ]


def document(result: FitResult) -> FitDocument:
    """JSON-ready summary of an identification; what the data do not determine is None.

    `theta` repeats all parameters of the model, so that later commands need no other file. The standard
    deviation of a direction that is not determined at all is None.
    """
    process = {n.name: entry(ProcessNoiseEntry, n, intensity=n.value) for n in _of_kind(result, "process")}
    sensors = {n.name: entry(MeasurementNoiseEntry, n, std=n.value) for n in _of_kind(result, "measurement")}
    return entry(
        FitDocument,
        result,
        parameters={p.name: p for p in result.parameters},
        noise={"process": process, "measurement": sensors},
        initial_state={s.experiment: _states(s.names, s.values, s.std_errors) for s in result.initial_states},
        correlation={"names": list(result.correlation_names), "matrix": _matrix(result.correlation)},
        **errors_entry(result.simulated),
        one_step=errors_entry(result.one_step),
        profiles={p.name: p for p in result.profiles},
        bootstrap=None if result.bootstrap is None else _bootstrap(result.bootstrap),
    )


def _of_kind(result: FitResult, kind: str) -> Iterator[FittedNoise]:
    return (noise for noise in result.noises if noise.kind == kind)


def _matrix(values: np.ndarray) -> list[list[float | None]]:
    return [[_number(v) for v in row] for row in values]


def _bootstrap(b: Bootstrap) -> BootstrapEntry:
    return {
        "level": b.level,
        "n": len(b.estimates),
        "n_failed": b.n_failed,
        "parameters": {
            name: {
                "lower": float(b.lower[i]),
                "upper": float(b.upper[i]),
                "mean": float(np.mean(b.estimates[:, i])),
                "std": float(np.std(b.estimates[:, i], ddof=1)),
            }
            for i, name in enumerate(b.names)
        },
    }


def _states(names: tuple[str, ...], values: np.ndarray, errors: np.ndarray) -> dict[str, StateEntry]:
    return {
        name: {"value": _number(value), "std_error": _number(error)}
        for name, value, error in zip(names, values, errors, strict=True)
    }


def _number(value: Any) -> float | None:
    """A float, None for what JSON cannot say."""
    return None if value is None or not math.isfinite(value) else float(value)
