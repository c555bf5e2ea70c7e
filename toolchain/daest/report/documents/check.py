"""The document of `daest check`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from daest.model.quality import ColumnSummary, DataCheck, Finding

SCHEMA = "daest/check/1"


def document(checks: Sequence[DataCheck]) -> dict[str, Any]:
    """JSON-ready findings of every recording; `n_warnings` counts those of all."""
    return {
        "schema": SCHEMA,
        "recordings": [_recording(check) for check in checks],
        "n_warnings": sum(len(check.warnings) for check in checks),
    }


def _recording(check: DataCheck) -> dict[str, Any]:
    return {
        "name": check.name,
        "n_samples": check.n_samples,
        "start": check.start,
        "stop": check.stop,
        "period": check.period,
        "columns": [_column(column) for column in check.columns],
        "findings": [finding_entry(finding) for finding in check.findings],
    }


def _column(column: ColumnSummary) -> dict[str, Any]:
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


def finding_entry(finding: Finding) -> dict[str, Any]:
    """A finding; `text` is a whole sentence."""
    return {
        "code": finding.code,
        "level": finding.level,
        "column": finding.column,
        "text": finding.sentence,
        "time": finding.at,
        "count": finding.count,
    }
