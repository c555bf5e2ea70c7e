"""The document of `daest check`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, TypedDict

from daest.model.experiment import DataCheck, Level, Role
from daest.report.documents.parts import Of, entry


class ColumnEntry(TypedDict):
    name: str
    unit: str | None
    role: Role | None
    n_values: int
    min: Annotated[float | None, Of("low")]
    max: Annotated[float | None, Of("high")]
    resolution: Annotated[float | None, "step of the values where they stand on a lattice"]
    noise_std: Annotated[float | None, Of("noise"), "of white noise where it shows"]


class FindingEntry(TypedDict):
    code: Annotated[str, "a code of daest explain"]
    level: Level
    column: str | None
    text: Annotated[str, Of("sentence")]
    time: Annotated[float | None, Of("at")]
    count: int


class RecordingEntry(TypedDict):
    name: str
    n_samples: int
    start: float
    stop: float
    period: Annotated[float | None, "null where the times are uneven"]
    clock: Annotated[str, "unit of the times"]
    columns: list[ColumnEntry]
    findings: list[FindingEntry]


class CheckDocument(TypedDict):
    """Faults of recordings."""

    recordings: list[RecordingEntry]
    n_warnings: int


def document(checks: Sequence[DataCheck]) -> CheckDocument:
    """JSON-ready findings of every recording; `n_warnings` counts those of all."""
    return {
        "recordings": [entry(RecordingEntry, check) for check in checks],
        "n_warnings": sum(len(check.warnings) for check in checks),
    }
