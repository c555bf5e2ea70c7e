"""The document of `daest check`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, TypedDict

from daest.model.quality import ColumnSummary, DataCheck, Finding, Level, Role


class ColumnEntry(TypedDict):
    name: str
    unit: str | None
    role: Role | None
    n_values: int
    min: float | None
    max: float | None
    resolution: Annotated[float | None, "step of the values where they stand on a lattice"]
    noise_std: Annotated[float | None, "of white noise where it shows"]


class FindingEntry(TypedDict):
    code: Annotated[str, "a code of daest explain"]
    level: Level
    column: str | None
    text: str
    time: float | None
    count: int


class RecordingEntry(TypedDict):
    name: str
    n_samples: int
    start: float
    stop: float
    period: Annotated[float | None, "s; null where the times are uneven"]
    columns: list[ColumnEntry]
    findings: list[FindingEntry]


class CheckDocument(TypedDict):
    """Faults of recordings."""

    recordings: list[RecordingEntry]
    n_warnings: int


def document(checks: Sequence[DataCheck]) -> CheckDocument:
    """JSON-ready findings of every recording; `n_warnings` counts those of all."""
    return {
        "recordings": [_recording(check) for check in checks],
        "n_warnings": sum(len(check.warnings) for check in checks),
    }


def _recording(check: DataCheck) -> RecordingEntry:
    return {
        "name": check.name,
        "n_samples": check.n_samples,
        "start": check.start,
        "stop": check.stop,
        "period": check.period,
        "columns": [_column(column) for column in check.columns],
        "findings": [finding_entry(finding) for finding in check.findings],
    }


def _column(column: ColumnSummary) -> ColumnEntry:
    return {
        "name": column.name,
        "unit": column.unit,
        "role": column.role,
        "n_values": column.n_values,
        "min": column.low,
        "max": column.high,
        "resolution": column.resolution,
        "noise_std": column.noise,
    }


def finding_entry(finding: Finding) -> FindingEntry:
    """A finding; `text` is a whole sentence."""
    return {
        "code": finding.code,
        "level": finding.level,
        "column": finding.column,
        "text": finding.sentence,
        "time": finding.at,
        "count": finding.count,
    }
