"""The json document of `daest design`."""

from __future__ import annotations

from typing import Annotated, NotRequired, TypedDict

import numpy as np

from daest.model.design import Design, Safety
from daest.report.documents.parts import Of, entry


class InputEntry(TypedDict):
    columns: Annotated[list[str], "headers of the file: time, then the inputs with their units"]
    period: Annotated[float, "seconds"]
    length: Annotated[float, "seconds"]
    hold: Annotated[str, "how the machine is to play it: zoh holds each value, foh runs straight between"]
    file: Annotated[str | None, "null: it was not written"]


class ExpectedEntry(TypedDict):
    value: float | None
    power: float | None
    log_likelihood_ratio: Annotated[dict[str, float], "of the closest case, by pair of rivals"]
    std_errors: Annotated[dict[str, float | None], "null where the recording does not determine one"]
    smallest_size: Annotated[float | None, "of the effect that is seen with 95 % power"]


class FamilyEntry(TypedDict):
    name: Annotated[str, Of("family")]
    shape: str
    value: Annotated[float | None, "see value_of"]
    rms: Annotated[dict[str, float], "standard deviation of each input: what the input costs"]
    reason: Annotated[str, "why the family was not played; empty where it was"]


class SensorEntry(TypedDict):
    variable: str
    same_as: Annotated[list[str], "variables that are the same but for their sign"]
    unit: str
    std: Annotated[float, "assumed noise"]
    value: Annotated[float, "see value_of"]
    gain: Annotated[float, "times better than without it"]
    closes: Annotated[bool, "determines parameters that no input does without it"]


class SafeEntry(TypedDict):
    limit: list[float]
    unit: Annotated[str, Of("range.unit")]
    reaches: list[float]
    probability: Annotated[float | None, "of leaving the limit, over the uncertainty of the parameters"]


class PowerEntry(TypedDict):
    length: float
    amplitude: Annotated[float, "relative to the designed input"]
    power: float
    smallest_size: float | None


class DirectionEntry(TypedDict):
    combination: dict[str, float]
    relative_std: float | None


class DesignDocument(TypedDict):
    """The next experiment."""

    aim: Annotated[str, "parameters, rivals or detect"]
    message: str
    input: InputEntry
    value_of: Annotated[str, "what the values are"]
    higher_is_better: bool
    predicted: Annotated[ExpectedEntry, Of("expected")]
    present: Annotated[ExpectedEntry | None, "the same of the recordings that there are"]
    together: Annotated[ExpectedEntry | None, "of these and the designed one"]
    families: list[FamilyEntry]
    sensors: list[SensorEntry]
    safe: dict[str, SafeEntry]
    power: list[PowerEntry]
    open_directions: Annotated[list[DirectionEntry], "parameters that are still told only together"]
    limits: dict[str, list[float]]
    notes: list[str]
    seconds: float
    model: NotRequired[str]


def document(found: Design, file: str | None = None) -> DesignDocument:
    """JSON-ready design; `file` is where the input was written."""
    limits = found.limits
    return entry(
        DesignDocument,
        found,
        input=entry(InputEntry, limits, columns=header(found), file=file),
        sensors=[
            entry(SensorEntry, s, variable=s.variables[0], same_as=s.variables[1:]) for s in found.sensors
        ],
        safe={s.range.name: _safe(s) for s in found.safety},
        limits={one.name: [one.low, one.high] for one in (*limits.inputs, *limits.safe)},
    )


def _safe(one: Safety) -> SafeEntry:
    limit, reaches = [one.range.low, one.range.high], [one.lowest, one.highest]
    return entry(SafeEntry, one, limit=limit, reaches=reaches)


def header(found: Design) -> list[str]:
    """Columns of the file to be played."""
    named = (f"{r.name} [{r.unit}]" if r.unit else r.name for r in found.limits.inputs)
    return [f"time [{found.limits.clock}]", *named]


def table(found: Design) -> tuple[list[str], np.ndarray]:
    """Header and rows (n_samples, 1 + n_u) of the file to be played."""
    return header(found), np.column_stack([found.limits.time, found.inputs])
