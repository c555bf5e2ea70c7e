"""Thresholds as one frozen value: each with its unit, its meaning and what set it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field, fields
from typing import Any

JUDGEMENT = "judgement; no study has varied it"
ROUNDING = "rounding of double precision"


def threshold(value: float, unit: str, meaning: str, study: str) -> Any:
    """A field of a subclass of `Thresholds`."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "study": study})


class Thresholds:
    """A frozen dataclass whose fields are made by `threshold`."""

    def rows(self) -> Iterator[tuple[str, float, str, str, str]]:
        """Name, value, unit, meaning and study of every threshold."""
        for f in fields(self):  # type: ignore[arg-type]
            told = f.metadata
            yield f.name, getattr(self, f.name), told["unit"], told["meaning"], told["study"]
