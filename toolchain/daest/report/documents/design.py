"""The json document of `daest design`."""

from __future__ import annotations

from typing import Annotated, NotRequired, TypedDict

import numpy as np

from daest.model.design import Design, SensorGain
from daest.report.documents.parts import entry


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
    name: str
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
    unit: str
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
    predicted: ExpectedEntry
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
    limits = found.limits
    return {
        "aim": found.aim,
        "message": found.message,
        "input": {
            "columns": header(found),
            "period": limits.period,
            "length": limits.length,
            "hold": limits.hold,
            "file": file,
        },
        "value_of": found.value_of,
        "higher_is_better": found.higher_is_better,
        "predicted": entry(ExpectedEntry, found.expected),
        "present": None if found.present is None else entry(ExpectedEntry, found.present),
        "together": None if found.together is None else entry(ExpectedEntry, found.together),
        "families": [entry(FamilyEntry, one, name=one.family) for one in found.families],
        "sensors": [_sensor(one) for one in found.sensors],
        "safe": {
            s.range.name: {
                "limit": [s.range.low, s.range.high],
                "unit": s.range.unit,
                "reaches": [s.lowest, s.highest],
                "probability": _number(s.probability),
            }
            for s in found.safety
        },
        "power": [entry(PowerEntry, p) for p in found.power],
        "open_directions": [entry(DirectionEntry, d) for d in found.open_directions],
        "limits": {one.name: [one.low, one.high] for one in (*limits.inputs, *limits.safe)},
        "notes": list(found.notes),
        "seconds": found.seconds,
    }


def header(found: Design) -> list[str]:
    """Columns of the file to be played."""
    return ["time [s]", *(f"{r.name} [{r.unit}]" if r.unit else r.name for r in found.limits.inputs)]


def table(found: Design) -> tuple[list[str], np.ndarray]:
    """Header and rows (n_samples, 1 + n_u) of the file to be played."""
    return header(found), np.column_stack([found.limits.time, found.inputs])


def _sensor(one: SensorGain) -> SensorEntry:
    return {
        "variable": one.variables[0],
        "same_as": list(one.variables[1:]),
        "unit": one.unit,
        "std": one.std,
        "value": one.value,
        "gain": one.gain,
        "closes": one.closes,
    }


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
