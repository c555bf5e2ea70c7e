"""Thresholds as one frozen value, read from a table beside the code: each with its unit, its meaning and what
set it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field, fields, make_dataclass
from pathlib import Path
from typing import Any

STUDIES = {"judgement": "judgement; no study has varied it", "rounding": "rounding of double precision"}
"""The short words for what set a threshold that every table may use."""


class Thresholds:
    """The frozen dataclass of a table: one field for each threshold."""

    def rows(self) -> Iterator[tuple[str, float, str, str, str]]:
        """Name, value, unit, meaning and study of every threshold."""
        for f in fields(self):  # type: ignore[arg-type]
            told = f.metadata
            yield f.name, getattr(self, f.name), told["unit"], told["meaning"], told["study"]


def read_thresholds(table: Path) -> Any:
    """The frozen value of a table, with an attribute for each of its thresholds.

    A row is `name | value | unit | meaning | what set it`; a value of digits alone is an int, every other a
    float. A line `word = text` makes a short word for what set several thresholds. A line that begins with #
    is a comment. A row with another number of parts is a `ValueError`.
    """
    studies, made = dict(STUDIES), []
    for line in table.read_text(encoding="utf-8").splitlines():
        if not line or line.startswith("#"):
            continue
        if " | " not in line:
            word, text = line.split(" = ", 1)
            studies[word] = text
            continue
        name, value, unit, meaning, study = line.split(" | ")
        kind = int if value.isdecimal() else float
        told = {"unit": unit, "meaning": meaning, "study": studies.get(study, study)}
        made.append((name, kind, field(default=kind(value), metadata=told)))
    return make_dataclass("Thresholds", made, bases=(Thresholds,), frozen=True)()
