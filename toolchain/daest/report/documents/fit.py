"""The document of `daest identify`: JSON content of a FitResult."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

import numpy as np

from daest.model.fit import (
    Bootstrap,
    Bound,
    FitResult,
    FittedInitialState,
    Method,
    ProfileEnd,
)
from daest.model.holds import Hold
from daest.report.documents.parts import ByPart, Errors, Fact, Of, entry, errors_entry


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
    intensity: Annotated[float, Of("value")]


class MeasurementNoiseEntry(FittedNoiseEntry):
    std: Annotated[float, Of("value")]


class NoiseEntry(TypedDict):
    process: dict[str, ProcessNoiseEntry]
    measurement: dict[str, MeasurementNoiseEntry]


class StateEntry(TypedDict):
    value: float | None
    std_error: float | None


class Correlation(TypedDict):
    names: Annotated[list[str], Of("correlation_names")]
    matrix: Annotated[list[list[float | None]], Of("correlation")]


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
    log_likelihood: Annotated[float | None, Fact("log-likelihood {}", 8)]
    start_log_likelihoods: NotRequired[list[float | None]]
    fit_percent: ByPart
    rms: ByPart
    one_step: Errors
    n_samples: int
    n_iterations: NotRequired[int]
    seconds: Annotated[float, Fact("{} s", 3)]
    period: float | None
    clock: Annotated[str, "unit of the period: what the model counts time in"]
    hold: Hold
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


def document(result: FitResult, clock: str = "s") -> FitDocument:
    """JSON-ready summary of an identification; what the data do not determine is None. The model counts time
    in the `clock`.

    `theta` repeats all parameters of the model, so that later commands need no other file. The standard
    deviation of a direction that is not determined at all is None.
    """
    return entry(
        FitDocument,
        result,
        noise={kind: [n for n in result.noises if n.kind == kind] for kind in ("process", "measurement")},
        initial_state={start.experiment: _states(start) for start in result.initial_states},
        correlation=entry(Correlation, result),
        **errors_entry(result.simulated),
        one_step=errors_entry(result.one_step),
        bootstrap=None if result.bootstrap is None else _bootstrap(result.bootstrap),
        clock=clock,
    )


def _bootstrap(b: Bootstrap) -> BootstrapEntry:
    spread = {"lower": b.lower, "upper": b.upper, "mean": np.mean(b.estimates, axis=0)}
    spread["std"] = np.std(b.estimates, axis=0, ddof=1)
    by_name = {name: {key: values[i] for key, values in spread.items()} for i, name in enumerate(b.names)}
    return entry(BootstrapEntry, b, n=len(b.estimates), parameters=by_name)


def _states(start: FittedInitialState) -> dict[str, dict[str, float]]:
    found = zip(start.names, start.values, start.std_errors, strict=True)
    return {name: {"value": value, "std_error": error} for name, value, error in found}
