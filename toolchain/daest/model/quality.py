"""What a look at a recording found before any model was fitted to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from daest.model.shown import Framed, Listing

Level = Literal["warning", "note"]
Role = Literal["input", "output"]


@dataclass(frozen=True)
class Finding:
    """One thing that was seen. A `warning` is probably a fault of the recording, a `note` something to know.

    `code` is explained by `daest explain`; `column` is None for what concerns no single one; `at` is the
    first time (s) and `count` how many samples, runs or steps there are. `text` is a sentence without its
    subject, which is the column, else `subject`.
    """

    code: str
    level: Level
    column: str | None
    text: str
    at: float | None = None
    count: int = 1
    subject: str = "the clock"

    @property
    def sentence(self) -> str:
        """The text with its subject."""
        return f"{self.column or self.subject} {self.text}"


@dataclass(frozen=True)
class ColumnSummary:
    """A column in numbers: `resolution` is the step of its values where they stand on a lattice, `noise` the
    standard deviation of white noise where it shows, both in the unit of the column, else None."""

    name: str
    unit: str | None
    role: Role | None
    n_values: int
    low: float | None
    high: float | None
    resolution: float | None
    noise: float | None


@dataclass(frozen=True)
class DataCheck(Framed):
    """A recording, its clock (period in s, None where uneven) and what was found."""

    name: str
    n_samples: int
    start: float
    stop: float
    period: float | None
    columns: tuple[ColumnSummary, ...]
    findings: tuple[Finding, ...]

    @property
    def warnings(self) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.level == "warning")

    def tables(self) -> tuple[Listing, ...]:
        title = f"{self.name}: {self.n_samples} samples, {self.start:.6g} s to {self.stop:.6g} s"
        rows = tuple((f.code, f.level, f.column, f.sentence, f.at, f.count) for f in self.findings)
        return (Listing(title, ("code", "level", "column", "text", "time", "count"), rows),)
